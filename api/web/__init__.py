"""REST, events and the pages of the service: thin faces over `api.web.live`."""
