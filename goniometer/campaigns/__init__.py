"""What is to be measured: campaigns, and their files."""
