# A campaign from a notebook: cells begin with "# %%", as Jupyter, VS Code and Spyder read them.
#
# Start a service with `goniometer serve` (the simulated bench, unless it is told of another), make a token with
# `goniometer token create`, and set GONIOMETER_URL and GONIOMETER_TOKEN. Nothing here knows whether the bench is real.

# %% Connect
import os
import time
from pathlib import Path

import numpy as np

from api import calls
from api.bodies.jobs import ExportAsked, HowAsked
from api.client import Client

bench = Client(os.environ["GONIOMETER_URL"], os.environ["GONIOMETER_TOKEN"])
print(bench(calls.about()))

# %% Plan: what will be measured, and how long it takes; nothing moves
CAMPAIGN = {
    "name": "From a notebook",
    "samples": [{"name": "Sample 4", "material": "sample-4"}],
    "incident": [20, 40, 60],
    "resolution": {"tolerance": 0.05, "colour_tolerance": 2},
    "reference": {"step": 10, "scans": 1},
    "monitor": None,
}
plan = bench(calls.preview(CAMPAIGN))
print(*plan.lines, *plan.findings, sep="\n")

# %% Measure: append it to the queue, start it, and mount what it asks for
entry = bench(calls.enqueue(CAMPAIGN))
bench(calls.entry_do(entry.id, "start"))
while (entry := bench(calls.entry(entry.id))).outcome is None:
    if entry.prompt is not None:
        print(entry.prompt.request, entry.prompt.check)  # on a real bench: do both, and only then go on
        bench(calls.entry_do(entry.id, "mounted"))
    time.sleep(0.5)
print(entry.outcome, entry.reason)
assert entry.campaign_id is not None

# %% Look: all spectra as NumPy arrays, points first, wavelengths last
(dataset,) = bench.every(calls.datasets(campaign=entry.campaign_id))
spectra = bench(calls.spectra(dataset.id))
relative = np.nanmedian(spectra.u / spectra.brdf)
print(f"{spectra.brdf.shape[0]} spectra, median standard uncertainty {100 * relative:.1f} % (k = 1)")
for check in bench(calls.checks(dataset.id)).checks:
    print({True: "passed", False: "FAILED", None: "open"}[check.passed], check.name, check.message, sep=": ")

# %% Fit: the models of the paper; a job runs in a process of its own and can be cancelled
bench.wait(bench(calls.fit(dataset.id, HowAsked(distribution="ggx"))))
ladder = bench(calls.models(dataset.id))
for model in ladder.models:
    values = ", ".join(f"{parameter.name} = {parameter.text}" for parameter in model.parameters)
    print(f"{model.name}: {values}; mean dE00 {model.absolute.mean:.2f}, {'' if model.trusted else 'NOT '}trusted")

# %% Draw: the distributions, with their uncertainty
from matplotlib.figure import Figure  # noqa: E402

figure = Figure(figsize=(7, 4), layout="constrained")
axes = figure.subplots()
for curve in bench(calls.distributions(dataset.id, 600.0, filled=False)).curves:
    brdf, u = np.array(curve.brdf, dtype=float), np.array(curve.u, dtype=float)
    axes.errorbar(curve.theta_out_deg, brdf, 2 * u, fmt=".-", label=f"{curve.theta_in_deg:.0f}°")
axes.set(yscale="log", xlabel="reflected angle / °", ylabel="BRDF at 600 nm / (1/sr), k = 2")
axes.legend(title="incident angle")
figure.savefig("distributions.png", dpi=150)

# %% Keep: the dataset with uncertainty, flags and lineage in one file
written = bench.wait(bench(calls.export(dataset.id, ExportAsked(format="hdf5"))))
Path(written["file"]).write_bytes(bench(calls.export_file(written["export"])))
print("Wrote", written["file"])
bench.close()
