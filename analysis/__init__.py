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
photographs             photo_statistics
what all rooms share    results, colour, choices, wording, strict_json
what can go wrong       errors
"""
