"""From counts to 1/sr, with every source of error."""
