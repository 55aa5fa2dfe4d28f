"""Where fits fail: difficult measurements held against their truth."""
