"""What can lie on the bench."""
