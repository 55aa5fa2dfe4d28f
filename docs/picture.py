"""The picture of the README: a sample's colours over both angles, and its spectra with their fits.

    goniometer demo
    python docs/picture.py demo/goniometer.db "Sample 4" docs/picture.svg

It is what the report of that sample shows, on a ground of its own, so that it can be read on a dark page, too.
"""

import re
import sys
from pathlib import Path

from analysis.figures.curves import spectra
from analysis.figures.maps import colour_map
from analysis.fits.analyse import analyse
from api.datasets import find_datasets
from goniometer.datasets.fill import fill, unmeasured
from goniometer.storage.store import Store

SCALES, GAP, FOOT = (1.35, 1.1), 8, 24
"""How much larger than in a report each panel is; points between them and for the line below."""


def picture(database: str, sample: str) -> str:
    """SVG of two panels."""
    store = Store.open(database)
    dataset = store.dataset(find_datasets(store, sample)[0])
    store.close()
    local = analyse(dataset, models=()).local
    filled = fill(dataset, *unmeasured(dataset, step=1.0))
    title = f"{sample}: colour of each direction under D65"
    sides = [
        colour_map(dataset, dataset.brdf, None, "map", title, measured=True, filled=filled),
        spectra(dataset, local, "spectra"),
    ]
    sizes = []
    for panel, scale in zip(sides, SCALES, strict=True):
        width, height = re.findall(r'viewBox="0 0 ([\d.]+) ([\d.]+)"', panel)[0]
        sizes.append((scale * float(width), scale * float(height)))
    across, up = sum(width for width, _ in sizes) + GAP, max(height for _, height in sizes)
    placed, left = "", 0.0
    for panel, (width, height) in zip(sides, sizes, strict=True):
        place = f'x="{left:.0f}" y="{up - height:.0f}" width="{width:.0f}" height="{height:.0f}"'
        placed += panel.replace("<svg ", f"<svg {place} ", 1)
        left += width + GAP
    said = (
        "left: hatched was not measured and is filled from around it; dashed: mirror direction; dotted: back into the "
        "lamp. right: bands are measured (k = 2), lines fitted"
    )
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {across:.0f} {up + FOOT:.0f}" color="#1f2328" '
        'font-family="DejaVu Sans, Verdana, sans-serif">'
        f'<rect width="100%" height="100%" rx="6" fill="#fbfaf8"/>{placed}<text x="{across / 2:.0f}" y="{up + 13:.0f}" '
        f'font-size="10" text-anchor="middle" fill="#59636e">{said}</text></svg>'
    )


if __name__ == "__main__":
    of, named, to = sys.argv[1:]
    Path(to).write_text(picture(of, named), encoding="utf-8")
