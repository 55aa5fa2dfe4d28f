"""What a measurement is and how one is run, calibrated, kept and exchanged.

Where what stands:

what is asked for       campaigns
the bench               bench
the bench measured      characterisation
the white reference     certificates
what is measured        datasets
between directions      interpolation
where to measure        plans
how a scan is run       scans
from counts to 1/sr     radiometry
the database            storage
its care                upkeep
files                   files
photographs             photographs
what all rooms share    geometry, constants, states, uncertainty, choices, wording, yaml_text
what can go wrong       errors
"""
