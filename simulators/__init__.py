"""Instruments that answer on the wire, and the optical bench behind them.

Where what stands:

instruments             smc100, owis, k10cr1, oriental_az, qepro, motion, wire, usb_plug, faults
the bench               laboratory, bench, clock, imperfections, measurement, camera, photo_session
what lies on it         materials, tabulated, tabulated_file, specimens, surfaces
topographies            topography, topography_file, nms_file, npz_file, heights, synthesis
waves                   waves, diffraction, power_spectrum, sampling, speckle, wave_scan, wave_convergence,
                        wave_simulation, gratings
rays                    rays, ray_kernel, ray_scan, ray_decomposition, multiple_reflection
simulated datasets      computed
where fits fail         regimes, stability, ensemble
speed against accuracy  tradeoff_bench, tradeoff_scans, tradeoff_simulations
choices, errors         choices, errors
"""
