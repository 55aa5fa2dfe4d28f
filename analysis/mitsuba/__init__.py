"""Scenes, renderings and the plugin for Mitsuba 3."""
