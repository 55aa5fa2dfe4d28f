"""Heavy work that the service is asked for: its kinds, its rows in the database, and the processes that do it."""
