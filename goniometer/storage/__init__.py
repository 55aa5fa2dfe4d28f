"""The database: its tables, what their rows are in Python, and how both follow the program."""
