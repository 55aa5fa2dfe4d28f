"""Faces and wiring: the service and the command line.

Where what stands:

the floors wired        service, settings, stages, preflight, preview, characterise, datasets
the command line        commands, terminal, inert_console, display, mount_request, choices
the service             web, views, events, logs
the bench of a service  bench
heavy work of a service jobs
who may use it          access
scripts that use it     client, calls, call
what is said to it      bodies
what datasets become    results, exports, simulated, written
where work is done      executor, cluster, prepared
bluesky                 bluesky_devices
what can go wrong       errors, named_errors
"""
