"""What a measurement is and how one is run: geometry, campaign, plan, scheduler, calibration, store.

Where what stands:

what is asked for       campaign, campaign_file, conditions, quantities, scene_weights, material_file, yaml_text,
                        wording, choices
the bench               instrument, arm, moves, route, safety, geometry, track, constants, exposure, meter, doctor
the bench measured      characterise, characterisation, alignment, lines, peaks
where to measure        plan, plan_spec, batches, refinement, interpolant, kernel, lobe, angular, learning,
                        colour_error, prescan, sweep
how a scan is run       scheduler, auxiliary, waiting, progress, estimate, duration
from counts to 1/sr     raw, signal, scatter, drift, response, reference, certificate, certificate_file,
                        calibration, footprint, provisional
uncertainty             sources, uncertainty, budget
what a dataset says     dataset, averages, checks, energy, reciprocity, between, sector, fill, lineage
the database            store, campaigns, records, states, tables, service_tables, look_up, catalogue, derived,
                        only_added, database, postgresql, filesystem
its care                backup, integrity, upgrade, migrations, archiving, archive_file
files of our own        dataset_file, dataset_document, dataset_hdf5, dataset_table
files of others         imported, measured_table, delimited, raw_text, published_json, bird_json, bird_metadata,
                        plain_hdf5
photographs             photos, photo_series, photo_files
what can go wrong       errors
"""
