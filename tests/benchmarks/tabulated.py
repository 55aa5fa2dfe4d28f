"""How far a material that is a table departs from what it is a table of.

Tables of known materials, read where they have no direction: along theta_out, between incident angles, in wavelength,
through the detector's aperture, and made of a scan. Relative errors, the largest of the wavelengths at each direction.

    python -m tests.benchmarks.tabulated
"""

import tempfile
from pathlib import Path

import numpy as np

from analysis.reflectance.directions import round_aperture
from drivers.arrays import FloatArray
from simulators.materials.materials import DETECTOR_APERTURE, SAMPLES, true_brdf
from simulators.materials.tabulated import Row, Tabulated, tabulated_brdf
from simulators.materials.tabulated_file import read_tabulated, write_tabulated
from tests.benchmarks.figures import tell
from tests.drawn_dataset import drawn_dataset

NM = np.array([450.0, 600.0, 750.0])
POINTS = 200


def table_of(
    name: str, incident: float, step: float, wavelengths: FloatArray = NM, aperture: float = DETECTOR_APERTURE
) -> Tabulated:
    """The table of a sample every `incident` degrees of theta_in up to 80 and `step` of theta_out.

    That of the mirror has a direction each 0.1 degrees in the lobe besides.
    """
    rows = []
    for theta_in in np.arange(0, 80.1, incident).tolist():
        theta_out = np.arange(-85, 85.01, step)
        if name == "sample-6":
            lobe = theta_in + np.arange(-3, 3.01, 0.1)
            theta_out = np.unique(np.round(np.append(theta_out, lobe[np.abs(lobe) <= 85]), 6))
        at = np.full(theta_out.size, theta_in), theta_out
        rows.append(Row(theta_in, theta_out, true_brdf(SAMPLES[name], *at, wavelengths, aperture)))
    return Tabulated(name, tuple(rows), wavelengths, aperture, 0, {}, "")


def errors(table: Tabulated, theta_in: FloatArray, theta_out: FloatArray, wavelengths: FloatArray = NM) -> FloatArray:
    """[points] largest relative error of the wavelengths, through the detector's aperture."""
    truth = true_brdf(SAMPLES[table.name], theta_in, theta_out, wavelengths)
    found = tabulated_brdf(table, theta_in, theta_out, wavelengths, round_aperture(DETECTOR_APERTURE))
    return np.asarray(np.abs(found / truth - 1).max(axis=1))


def rms(found: FloatArray) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(found**2)))


def shown(found: FloatArray) -> str:
    """Root mean square, 95 % quantile and maximum in per cent."""
    return " / ".join(f"{100 * v:6.2f}" for v in (rms(found), np.quantile(found, 0.95), found.max()))


def main() -> None:
    """Print the tables."""
    random = np.random.default_rng(0)
    print("Errors in per cent: root mean square / 95 % / largest\n")
    print("sample    theta_in  theta_out  along theta_out           between theta_in          the same, in the lobe")
    for name in ("sample-1", "sample-4", "sample-6"):
        for incident, step in ((10.0, 5.0), (10.0, 2.5), (10.0, 1.0), (5.0, 2.5), (5.0, 1.0), (2.0, 1.0)):
            table = table_of(name, incident, step)
            rows = random.choice([row.theta_in for row in table.rows], POINTS)
            between, everywhere = random.uniform(0, 80, POINTS), random.uniform(-85, 85, POINTS)
            lobe = np.clip(between + random.uniform(-2, 2, POINTS), -85, 85)
            parts = [errors(table, *at) for at in ((rows, everywhere), (between, everywhere), (between, lobe))]
            print(f"{name}  {incident:5g} deg  {step:5g} deg  " + "  ".join(map(shown, parts)))
            if (incident, step) == (10.0, 1.0):
                for where, off in zip(("along theta_out", "between theta_in"), parts, strict=False):
                    tell(f"{name}, table of 10° and 1°: rms error {where}", 100 * rms(off), "%")
    print("\nLinear in wavelength from 380 to 995 nm, aluminium, in the mirror direction at 40 deg")
    fine, at = np.arange(380.0, 995.1, 1.0), (np.array([40.0]), np.array([40.0]))
    for width in (5.0, 10.0, 20.0, 40.0):
        wavelengths = np.unique(np.append(np.arange(380.0, 995.1, width), 995.0))
        table = table_of("sample-1", 40.0, 5.0, wavelengths)
        off = tabulated_brdf(table, *at, fine) / true_brdf(SAMPLES["sample-1"], *at, fine) - 1
        print(f"every {width:3g} nm  {shown(np.abs(off[0]))}")
    print("\nA table without aperture, every 10 deg of theta_in and 1 deg of theta_out, averaged over the detector's")
    for name in ("sample-1", "sample-4", "sample-8"):
        table = table_of(name, 10.0, 1.0, aperture=0.0)
        rows = random.choice([row.theta_in for row in table.rows], POINTS)
        near = np.clip(rows + random.uniform(-2, 2, POINTS), -84, 84)
        print(f"{name}  everywhere {shown(errors(table, rows, random.uniform(-84, 84, POINTS)))}", end="")
        print(f"  in the lobe {shown(errors(table, rows, near))}")
    print("\nA table of a drawn scan, at the incident angles of the scan")
    for name in ("sample-1", "sample-4", "sample-5"):
        dataset = drawn_dataset(name, zeros=(0.0, 0.0), reference_error=0.0)
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder, "table.npz")
            write_tabulated(path, dataset)
            table = read_tabulated(path)
        rows = random.choice([row.theta_in for row in table.rows], 3 * POINTS)
        ends = {row.theta_in: (row.theta_out[0], row.theta_out[-1]) for row in table.rows}
        theta_out = np.array([random.uniform(*ends[t]) for t in rows.tolist()])
        off = errors(table, rows, theta_out, dataset.wavelengths)
        sector = np.abs(rows + theta_out) < 5
        told = f"{dataset.theta_in.size} points, {table.filled} directions filled"
        print(f"{name}  {told}: in the sector {shown(off[sector])}, elsewhere {shown(off[~sector])}")
        tell(f"{name}, table of a scan: rms error in the blocked sector", 100 * rms(off[sector]), "%")
        tell(f"{name}, table of a scan: rms error elsewhere", 100 * rms(off[~sector]), "%")


if __name__ == "__main__":
    main()
