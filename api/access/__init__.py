"""Who may use the service, who asks, and who did what."""
