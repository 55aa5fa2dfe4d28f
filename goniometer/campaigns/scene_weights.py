"""How much a scene needs to know of each direction, so that no more is measured than it needs.

`goniometer choose --weights` writes such a file, and a campaign names it under `resolution.scene`. Weights stand on
nodes of theta_h, between half vector and normal, and theta_d, between incident direction and half vector, because a
direction out of the plane asks for the one in the plane with the same two: theta_in = theta_d + theta_h and
theta_out = theta_d - theta_h. What lies beyond the mirror direction is its reverse, and is not measured again.
"""

import json
from pathlib import Path
from typing import Annotated, Self

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from drivers.arrays import FloatArray
from goniometer.errors import CampaignError
from goniometer.wording import describe

STEP_H, STEP_D = 2.5, 10.0
"""Distance of nodes, degrees: as fine as a scene's weights change, as coarse as incident angles lie apart."""

ELSEWHERE = 0.003
"""Weight of directions that the scene does not ask for, as a part of the largest: so much it may be wrong about."""

Weight = Annotated[float, Field(ge=0, allow_inf_nan=False)]


class SceneWeights(BaseModel):
    """What a scene asks for."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    scene: str = Field(description="Its name.")
    colour_slope: float = Field(
        gt=0,
        allow_inf_nan=False,
        description="Mean dE00 of the image where ln f is off by the same everywhere, for each unit of that.",
    )
    weights: tuple[tuple[Weight, ...], ...] = Field(
        description=f"Rows of theta_h every {STEP_H:g} degrees, columns of theta_d every {STEP_D:g}, both from 0 to 90."
    )

    @model_validator(mode="after")
    def _shaped(self) -> Self:
        rows, columns = round(90 / STEP_H) + 1, round(90 / STEP_D) + 1
        if len(self.weights) != rows or any(len(row) != columns for row in self.weights):
            raise ValueError(f"weights must have {rows} rows of {columns} numbers")
        if not any(value > 0 for row in self.weights for value in row):
            raise ValueError("all weights are zero: the scene asks for nothing that can be measured")
        return self

    def importance(self, theta_in: FloatArray, theta_out: FloatArray) -> FloatArray:
        """[points] how much directions matter, at theta_in and theta_out [points], degrees; at least a little."""
        table = np.array(self.weights)
        half, difference = (theta_in - theta_out) / 2, np.abs(theta_in + theta_out) / 2
        row, column = np.abs(half) / STEP_H, difference / STEP_D
        r, c = (np.minimum(at.astype(int), size - 2) for at, size in zip((row, column), table.shape, strict=True))
        down, right = row - r, column - c
        below = table[r, c] * (1 - right) + table[r, c + 1] * right
        above = table[r + 1, c] * (1 - right) + table[r + 1, c + 1] * right
        asked = np.where(half >= -STEP_H / 2, below * (1 - down) + above * down, 0.0)
        return np.asarray(asked + ELSEWHERE * table.max())


def weights_on_nodes(theta_h: FloatArray, theta_d: FloatArray, weight: FloatArray) -> FloatArray:
    """[rows, columns] of `SceneWeights`, of `weight` [vertices] at angles [vertices], degrees; they sum to one."""
    table = np.zeros((round(90 / STEP_H) + 1, round(90 / STEP_D) + 1))
    row, column = theta_h / STEP_H, theta_d / STEP_D
    r, c = (np.minimum(at.astype(int), size - 2) for at, size in zip((row, column), table.shape, strict=True))
    for down in (0, 1):
        for right in (0, 1):
            share = np.abs(1 - down - (row - r)) * np.abs(1 - right - (column - c))
            np.add.at(table, (r + down, c + right), share * weight)
    return np.asarray(table / table.sum())


def read_weights(path: Path) -> SceneWeights:
    """The weights in a file; raises `CampaignError`, one line with the file and what would be right."""
    try:
        return SceneWeights.model_validate(json.loads(path.read_text(encoding="utf-8")))
    except OSError as error:
        raise CampaignError(f"{path}: the weights of the scene cannot be read: {error.strerror or error}") from None
    except ValidationError as error:
        raise CampaignError(f"{path}: {describe(error, SceneWeights)}") from None
    except ValueError as error:
        raise CampaignError(f"{path}: the weights of the scene are not valid JSON: {error}") from None
