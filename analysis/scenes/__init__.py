"""What a scene asks of its material, and the simplest model that answers it."""
