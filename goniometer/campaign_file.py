"""A campaign file (YAML or JSON) becomes a `Campaign`, or one line that says what is wrong where."""

from pathlib import Path
from typing import Any, NoReturn

import yaml
from pydantic import ValidationError

from goniometer.campaign import Campaign, Sample
from goniometer.errors import CampaignError
from goniometer.material_file import material_file
from goniometer.scene_weights import read_weights
from goniometer.wording import describe


class _StrictLoader(yaml.SafeLoader):
    """YAML in which a key given twice is a mistake; the standard loader silently keeps the last."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        seen: set[str] = set()
        for key, _ in node.value:
            if isinstance(key, yaml.ScalarNode):
                if key.value in seen:
                    raise yaml.MarkedYAMLError(None, None, f'the key "{key.value}" is given twice', key.start_mark)
                seen.add(key.value)
        return super().construct_mapping(node, deep)


def load_campaign(path: Path | str) -> Campaign:
    """Read and check a campaign file; relative paths of a certificate, of materials and of a scene's weights are taken
    from its own folder.

    Raises `CampaignError`, one line with the file, the key, what is wrong and what would be right.
    """
    path = Path(path)
    try:
        content = yaml.load(path.read_text(encoding="utf-8"), _StrictLoader)  # a SafeLoader, and JSON is YAML
    except OSError as error:
        raise CampaignError(f"{path}: the campaign file cannot be read: {error.strerror or error}") from None
    except UnicodeDecodeError:
        raise CampaignError(f"{path}: the campaign file is not UTF-8 text") from None
    except yaml.YAMLError as error:
        _refuse_yaml(path, error)
    except RecursionError:
        raise CampaignError(f"{path}: the campaign file is nested too deeply; a campaign needs four levels") from None
    except (ValueError, LookupError, AttributeError) as error:  # what the loader lets through of an impossible value
        raise CampaignError(
            f"{path}: the campaign file holds a value that is not possible ({error}); write a text in quotes"
        ) from None
    if not isinstance(content, dict):
        raise CampaignError(f"{path}: a campaign is a mapping with the keys name and samples, not {_kind(content)}")
    resolution = content.get("resolution")
    if isinstance(resolution, dict) and isinstance(resolution.get("scene"), str):
        # what a campaign asks for must not change with a file while it runs
        weights = read_weights(path.parent / resolution["scene"])
        content["resolution"] = resolution | {"scene": weights.model_dump()}
    try:
        campaign = Campaign.model_validate(content)
    except ValidationError as error:
        raise CampaignError(f"{path}: {describe(error, Campaign)}") from None
    except UnicodeEncodeError as error:  # half of a pair that stands for one character, which JSON can spell
        raise CampaignError(
            f"{path}: a text of the campaign holds {error.object[error.start]!a}, which is no character; leave it out"
        ) from None
    samples = tuple(_located(sample, path.parent) for sample in campaign.samples)
    campaign = campaign.model_copy(update={"samples": samples})
    certificate = campaign.reference.certificate
    if certificate is None:
        return campaign
    located = str(path.parent / certificate)
    return campaign.model_copy(update={"reference": campaign.reference.model_copy(update={"certificate": located})})


def _located(sample: Sample, folder: Path) -> Sample:
    """A sample whose material, where it is a file, is found from any folder."""
    file = material_file(sample.material)
    if file is None:
        return sample
    return sample.model_copy(update={"material": str(file._replace(path=(folder / file.path).absolute()))})


def _refuse_yaml(path: Path, error: yaml.YAMLError) -> NoReturn:
    """Raise the one-line form of a YAML error."""
    where = ""
    if isinstance(error, yaml.MarkedYAMLError) and error.problem_mark is not None:
        where = f" in line {error.problem_mark.line + 1}"
    problem = getattr(error, "problem", None) or str(error).splitlines()[0]
    raise CampaignError(f"{path}: the campaign file is not valid YAML{where}: {problem}") from None


def _kind(value: object) -> str:
    return {dict: "a mapping", list: "a list", str: "text", type(None): "nothing"}.get(type(value), repr(value))
