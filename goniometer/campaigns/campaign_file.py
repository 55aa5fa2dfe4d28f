"""A campaign file (YAML or JSON) becomes a `Campaign`, or one line that says what is wrong where."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from goniometer.campaigns.campaign import Campaign, Sample
from goniometer.campaigns.material_file import material_file
from goniometer.campaigns.scene_weights import read_weights
from goniometer.errors import CampaignError
from goniometer.wording import describe, ordered
from goniometer.yaml_text import line_of, parsed_yaml


def load_campaign(path: Path | str) -> Campaign:
    """Read and check a campaign file; relative paths start at its own folder.

    These are those of a certificate, of materials and of a scene's weights.

    Raises `CampaignError`, one line with the file, the key, what is wrong and what would be right.
    """
    path = Path(path)
    try:
        text = path.read_text(encoding="utf-8")
    except OSError as error:
        raise CampaignError(f"{path}: the campaign file cannot be read: {error.strerror or error}") from None
    except UnicodeDecodeError:
        raise CampaignError(f"{path}: the campaign file is not UTF-8 text") from None
    return _campaign(_content(text, str(path)), str(path), lambda name: path.parent / name, text)


def read_campaign(sent: str | dict[str, Any], folder: Path) -> Campaign:
    """Check a campaign that somebody has sent, as YAML, JSON or what JSON holds; files that it names lie in `folder`.

    Raises `CampaignError` as `load_campaign` does, and where it names a file that lies elsewhere.
    """

    def inside(name: str) -> Path:
        try:
            path = (folder / name).resolve()
        except (ValueError, OSError):  # characters that no name of a file has
            path = folder / ".."
        if not path.is_relative_to(folder.resolve()) or ".." in path.parts:
            raise CampaignError(f"campaign: {name!r} lies outside the folder of the service's files; put it in there")
        return path

    if isinstance(sent, str):
        return _campaign(_content(sent, "campaign"), "campaign", inside, sent)
    return _campaign(sent, "campaign", inside)


def _content(text: str, where: str) -> object:
    """What the text of a campaign file holds; `where` names it in messages."""
    try:
        return parsed_yaml(text)  # JSON is YAML
    except ValueError as error:
        raise CampaignError(f"{where}: the campaign file {error}") from None


def _campaign(content: object, where: str, locate: Callable[[str], Path], text: str = "") -> Campaign:
    """The campaign of what a file holds; `locate` finds the files that it names, faults are looked up in its `text`."""
    if not isinstance(content, dict):
        raise CampaignError(f"{where}: a campaign is a mapping with the keys name and samples, not {_kind(content)}")
    resolution = content.get("resolution")
    if isinstance(resolution, dict) and isinstance(resolution.get("scene"), str):
        # what a campaign asks for must not change with a file while it runs
        weights = read_weights(locate(resolution["scene"]))
        content = content | {"resolution": resolution | {"scene": weights.model_dump()}}
    try:
        campaign = Campaign.model_validate(content)
    except ValidationError as error:
        lines = _lines(text, error) if text else ""
        raise CampaignError(f"{where}{lines}: {describe(error, Campaign)}") from None
    except UnicodeEncodeError as error:  # half of a pair that stands for one character, which JSON can spell
        raise CampaignError(
            f"{where}: a text of the campaign holds {error.object[error.start]!a}, which is no character; leave it out"
        ) from None
    samples = tuple(_located(sample, locate) for sample in campaign.samples)
    campaign = campaign.model_copy(update={"samples": samples})
    certificate = campaign.reference.certificate
    if certificate is None:
        return campaign
    located = str(locate(certificate))
    return campaign.model_copy(update={"reference": campaign.reference.model_copy(update={"certificate": located})})


def _lines(text: str, error: ValidationError) -> str:
    """In which lines the faults are, that of the one that is told first, e.g. ", lines 6, 3 and 5"."""
    told, *more = [line_of(text, fault["loc"]) for fault in ordered(error)]
    *others, last = map(str, [told, *sorted({*more} - {told})])
    return f", lines {', '.join(others)} and {last}" if others else f", line {last}"


def _located(sample: Sample, locate: Callable[[str], Path]) -> Sample:
    """A sample whose material, where it is a file, is found from any folder."""
    file = material_file(sample.material)
    if file is None:
        return sample
    return sample.model_copy(update={"material": str(file._replace(path=locate(str(file.path)).absolute()))})


def _kind(value: object) -> str:
    return {dict: "a mapping", list: "a list", str: "text", type(None): "nothing"}.get(type(value), repr(value))
