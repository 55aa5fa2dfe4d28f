"""The whole job on the simulated bench: how long it takes, how few points it needs, and what of the truth it finds.

    python -m tests.benchmarks.demo

runs what `goniometer demo` runs.
"""

import asyncio
import tempfile
import time
from pathlib import Path

from api.commands.demo import demo
from api.service import QUIET
from tests.benchmarks.figures import tell

MODELS = {"cook-torrance": "Cook-Torrance", "cook-torrance-shift": "Cook-Torrance with shift"}


def main() -> None:
    """Run it in a folder that is thrown away."""
    began = time.monotonic()
    with tempfile.TemporaryDirectory() as folder:
        result = asyncio.run(demo(Path(folder), 1, QUIET))
    tell("`goniometer demo`", time.monotonic() - began, "s", "< 120")
    tell("the bench would have needed", result.bench_seconds / 3600, "h")
    tell("faults of it", len(result.failures), aim="= 0")
    for sample in result.samples:
        share = f"(a grid of 1° has {sample.uniform_1_degree_points})"
        tell(f"{sample.sample}: points", sample.points, share, f"< {sample.uniform_1_degree_points}")
        for model, title in MODELS.items():
            found = sample.dE00[model]
            tell(f"{sample.sample}: mean dE00, {title}", found["absolute"]["mean"], _chromatic(found))
    for sample in result.samples[:2]:
        for each in sample.parameters["cook-torrance-shift"]:
            z = abs(each["value"] - each["true"]) / each["standard_error"]
            told = f"({each['value']:.5g}, truly {each['true']:g})"
            tell(f"{sample.sample}: standard errors between {each['name']} and the truth", z, told, "< 3")
    tell("models of the mirror that are said to be trusted", sum(result.samples[2].trusted.values()), aim="= 0")


def _chromatic(found: dict[str, dict[str, float]]) -> str:
    return f"(chromatic {found['chromatic']['mean']:.2f})"


if __name__ == "__main__":
    main()
