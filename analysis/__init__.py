"""Reflectance models, their fits, colour, exports and figures.

Where what stands:

models                  models, directions, distributions, fresnel, two_component, brdf_table, ladder, choices
local and global fits   local_fit, local_lmfit, local_misfit, noise, global_fit, global_verdict
microfacet fits         brdf_fit, brdf_problem, brdf_start, brdf_two_component, brdf_errors, microfacet, loew,
                        identify, misfit, structure
what fits share         least_squares, propagation, brdf_draws
results                 analyse, fits, results, stored_fit, fit_json, notation, wording
colour                  colour, shown_colours
files for renderers     export_mitsuba, export_plugin, ggx_shift, rendered_model, measured_bsdf, bsdf_fields,
                        bsdf_search, bsdf_energy, bsdf_error, tensor_file
Mitsuba                 mitsuba_scene, mitsuba_run, mitsuba_worker, render, render_worker, render_report,
                        vase_scene
the model of a scene    scene, scene_rays, vertices, asked, choose, choose_report, verify
speed against accuracy  tradeoff, tradeoff_fits, tradeoff_models, tradeoff_renders, tradeoff_figure
reports                 report, report_measured, report_models, report_quality, page
figures                 figures, svg, albedo_figure, budget_figure, characterisation_figures, filled_figure,
                        grating_figures, plan_figure, ray_figures, stability_figure, surface_figures
photographs             photo_statistics, photo_figures, photo_page
what can go wrong       errors
"""
