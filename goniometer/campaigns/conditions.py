"""What must hold before a scan begins, as a campaign asks for it; `goniometer.scans.waiting` sees to it."""

from typing import Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

from goniometer.campaigns.quantities import Duration, Ratio


class Conditions(BaseModel):
    """What must hold before every scan, and again after a pause."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    cooler_stable: bool = Field(default=True, description="Whether the detector must rest at its set point.")
    lamp_warm: Duration | None = Field(
        default=None, gt=0, description="Least time since the lamp was switched on, seconds; null: any."
    )
    lamp_change: Ratio | None = Field(
        default=None, gt=0, lt=1, description="Most relative change of the lamp's signal in a while; null: any."
    )
    lamp_change_within: Duration = Field(default=60.0, gt=0, description="That while, seconds.")
    patience: Duration = Field(default=3600.0, gt=0, description="Time after which a scan fails, seconds.")

    @model_validator(mode="after")
    def _possible(self) -> Self:
        for name, least in (("lamp_warm", self.lamp_warm), ("lamp_change_within", self.lamp_change_within)):
            asked = name == "lamp_warm" or self.lamp_change is not None
            if asked and least is not None and least > self.patience:
                raise ValueError(
                    f"{name} ({least:g} s) cannot hold within a patience of {self.patience:g} s: be more patient"
                )
        return self
