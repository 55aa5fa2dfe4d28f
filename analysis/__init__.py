"""Reflectance models, their fits, colour, exports and figures.

Where what stands:

models                  reflectance
their fits              fits
the model of a scene    scenes
files for renderers     bsdf
Mitsuba                 mitsuba
speed against accuracy  costs, tradeoff
figures                 figures
pages                   reports
what all rooms share    results, colour, photo_statistics, choices, wording
what can go wrong       errors
"""
