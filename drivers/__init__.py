"""Device interfaces and the drivers of real instruments.

Where what stands:

what a device is        interfaces, errors, arrays, clock
rotation stages         stage, travel, smc100, owis, k10cr1, apt, oriental_az
spectrometer, camera    qepro, qepro_wire, obp, gphoto2_camera, device_thread
wires                   serial_port, modbus_line, usb_link
"""
