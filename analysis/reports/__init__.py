"""Pages of HTML that explain themselves."""
