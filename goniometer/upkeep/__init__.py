"""The care of a database: backups, checks, upgrades and archives."""
