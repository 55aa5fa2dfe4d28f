"""How the colour changes with direction: slope of every spectrum, and what the models make of all of them."""

import numpy as np

from analysis.fits.by_name import fitted_slope
from analysis.fits.stored_fit import StoredFit
from analysis.reflectance.directions import in_plane
from analysis.reflectance.models import LAMBDA_N
from api.bodies.base import number, numbers
from api.bodies.plots import LocalPoint, SlopeCurve, SlopeModel, Slopes
from api.views.opened import Opened
from goniometer.datasets.angular import SAME_INCIDENCE, incidence_groups
from goniometer.datasets.dataset import Dataset

_GRID = np.linspace(-90.0, 90.0, 181)


def slopes(opened: Opened) -> Slopes:
    """Slopes of the spectra, and of the newest fit of every model that has a shift."""
    dataset, local = opened.dataset, local_points(opened) or {}
    about = {} if opened.analysis is None else opened.analysis["local"]
    angles = _incident_angles(dataset)
    shown = [fit for fit in opened.models.values() if _has_shift(fit)]
    return Slopes(
        dataset=opened.entry.id,
        lambda_n_nm=float(about.get("lambda_n_nm", LAMBDA_N)),
        doubts=list(about.get("doubts", ())),
        points=list(local.values()),
        theta_out_deg=_GRID.tolist(),
        models=[
            SlopeModel(
                model=fit.model,
                fit=opened.newest[fit.model].id,
                trusted=fit.verdict.trusted,
                curves=[
                    SlopeCurve(
                        theta_in_deg=angle,
                        slope_per_um=numbers(fitted_slope(fit, in_plane(np.full_like(_GRID, angle), _GRID))),
                    )
                    for angle in angles
                ],
            )
            for fit in shown
        ],
    )


def local_points(opened: Opened) -> dict[int, LocalPoint] | None:
    """The local fit by the number of the point; without directions that the detector blocks. None: not analysed."""
    if opened.analysis is None:
        return None
    local, dataset = opened.analysis["local"], opened.dataset
    # the file leaves out what is blocked, so a point is found by its direction, which is there to the last bit
    pairs = zip(dataset.theta_in.tolist(), dataset.theta_out.tolist(), strict=True)
    number_of = {pair: i for i, pair in enumerate(pairs)}
    columns = ("theta_in_deg", "theta_out_deg", "m_per_um", "u_m_per_um", "p", "u_p", "a_per_sr", "r2", "reliable")
    found = {}
    for row in zip(*(local[name] for name in columns), strict=True):
        point = number_of[row[0], row[1]]
        m, u_m, p, u_p, a, r2 = map(number, row[2:8])
        found[point] = LocalPoint(
            point=point, theta_in_deg=row[0], theta_out_deg=row[1], slope_per_um=m, u_slope_per_um=u_m, exponent=p,
            u_exponent=u_p, scale_per_sr=a, r2=r2, reliable=row[8],
        )  # fmt: skip
    return found


def _incident_angles(dataset: Dataset) -> list[float]:
    groups = incidence_groups(dataset.theta_in, SAME_INCIDENCE)
    return [float(dataset.theta_in[groups == g].mean()) for g in range(int(groups.max()) + 1)]


def _has_shift(fit: StoredFit) -> bool:
    return fit.model not in {"cook-torrance", "dielectric"}
