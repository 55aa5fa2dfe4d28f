"""A campaign file means what it says, and a mistake in it gets one line that tells where and what to do."""

import hashlib
import json
import math

import pytest

from goniometer.campaigns.campaign import Campaign
from goniometer.campaigns.campaign_file import load_campaign
from goniometer.errors import CampaignError

SMALLEST = "name: First light\nsamples:\n  - {name: Sample 1, material: sample-1}\n"


def load(tmp_path, text):
    path = tmp_path / "campaign.yaml"
    path.write_text(text, encoding="utf-8")
    return load_campaign(path)


def test_the_smallest_campaign_measures_what_the_paper_did(tmp_path):
    campaign = load(tmp_path, SMALLEST)
    assert campaign.theta_in == (0, 10, 20, 30, 40, 50, 60, 70, 80)
    assert (campaign.outgoing.start, campaign.outgoing.stop) == (-85, 85)


def test_a_quantity_means_the_same_with_any_of_its_units(tmp_path):
    campaign = load(
        tmp_path,
        SMALLEST + "incident: [0, '10 deg', '0.5 rad', 15°]\n"
        "integration: {minimum: 8000 us, maximum: 0.5 min, fill: 0.6}\nresolution: {minimum_step: 0.5 deg}\n",
    )
    assert campaign.theta_in == pytest.approx((0, 10, 15, math.degrees(0.5)))
    assert campaign.integration.minimum == pytest.approx(0.008)
    assert campaign.integration.maximum == pytest.approx(30)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("name: a\nsamples: [{name: s, materal: m}]", ["samples[0].materal", 'did you mean "material"']),
        ("name: a\nsamples: [{name: s, material: m}, {name: t}]", ["samples[1].material", "missing"]),
        ("name: a\nsamples: []", ["samples", "at least 1"]),
        (
            SMALLEST + "incident: [0, 95]\nresolution:\n  tolerence: 1\n",
            ["lines 6 and 4: resolution.tolerence", "more"],
        ),
        (SMALLEST + "incident:\n  - 0\n  - 10 nm\n", ["line 6: incident[1]"]),
        (SMALLEST + "  - name: s\n", ["line 4: samples[1].material", "missing"]),
        ("name: 7\nsamples: [{name: s, material: m}]", ["name", "quotes"]),
        ("name: a\nsamples: [{name: s, material: m}, {name: s, material: n}]", ["samples", '"s"', "its own name"]),
        (SMALLEST + "incident: [0, 10 nm]", ["incident[1]", '"nm"', "deg"]),
        (SMALLEST + "incident: {start: 0, stop: 80 s, step: 10}", ["incident.stop", '"s"', "deg"]),
        (SMALLEST + "incident: [95]", ["incident", "95 deg", "between 0 and 85"]),
        (SMALLEST + "incident: [-10]", ["incident", "-10 deg", "between 0 and 85"]),
        (SMALLEST + "incident: [10, 10]", ["incident", "twice"]),
        (SMALLEST + "incident: {start: 0, stop: 80, step: 7}", ["incident", "7 deg", "does not divide"]),
        (SMALLEST + "incident: {start: 0, stop: 80, step: 1.0e-9}", ["incident.step", "0.05"]),
        (SMALLEST + "incident: {start: 0, stop: 1.0e+300, step: 10}", ["incident.stop", "85"]),
        (SMALLEST + "resolution: {step: 1.0e-9}", ["resolution.step", "0.05"]),
        (SMALLEST + "reference: {step: 1.0e-9}", ["reference.step", "0.05"]),
        (SMALLEST + "incident: [0, 20]\noutgoing: {start: -24, stop: -16}", ["outgoing", "20 deg", "blocks"]),
        ("name: 2020-13-45\nsamples: [{name: s, material: m}]", ["month", "quotes"]),
        (SMALLEST + "seed: " + "9" * 5000, ["not possible", "digits"]),
        ("name: " + "[" * 5000 + "]" * 5000, ["nested too deeply"]),
        (SMALLEST + "incident: {start: 0, stop: 80, stepp: 7}", ["incident.stepp", 'did you mean "step"']),
        (SMALLEST + "incident: everything", ["incident", "a list of angles"]),
        (SMALLEST + "outgoing: {start: -100}", ["outgoing.start", "-100", "-85"]),
        (SMALLEST + "outgoing: wide", ["outgoing", "start, stop"]),
        (SMALLEST + "integration: {maximum: 30 deg}", ["integration.maximum", '"deg"', "ms"]),
        (SMALLEST + "integration: {maximum: .inf}", ["integration.maximum", "finite"]),
        (SMALLEST + "integration: {minimum: 40}", ["integration", "40 s", "30 s"]),
        (SMALLEST + "integration: {fill: 2}", ["integration.fill", "0.95"]),
        (SMALLEST + "integration: {signal_to_noise: 0}", ["integration.signal_to_noise", "greater than 0"]),
        (SMALLEST + "integration: {exposures: 4}", ["integration.exposures", "3"]),
        (SMALLEST + "integration: {minimum: 0.1, time_limit: 50 ms}", ["integration", "0.1 s", "time_limit (0.05 s)"]),
        (SMALLEST + "monitor: {every: 0}", ["monitor.every", "greater than 0"]),
        (SMALLEST + "monitor: {evry: 5 min}", ["monitor.evry", 'did you mean "every"']),
        (SMALLEST + "homogeneity: {points: 0}", ["homogeneity.points", "1"]),
        (SMALLEST + "prescan: {step: 3 deg}", ["prescan.step", "2"]),
        (SMALLEST + "prescan: {}\nresolution: {mode: uniform}", ["prescan", "even grid"]),
        (SMALLEST + "reference: {override: {name: A. Smith}}", ["reference.override.reason", "missing"]),
        (
            SMALLEST + "reference: {override: {name: A. Smith, reason: ' '}}",
            ["reference.override.reason", "at least 1"],
        ),
        (SMALLEST + "reference: {diameter: 0 mm}", ["reference.diameter", "greater than 0"]),
        ("name: a\nsamples: [{name: s, material: m, diameter: 2 in}]", ["samples[0].diameter", '"in"', "mm, cm"]),
        (SMALLEST + "rounds: 0", ["rounds", "1"]),
        ("name: a\nsamples: [{name: s, material: m, repeats: 0}]", ["samples[0].repeats", "1"]),
        ("name: a\nsamples: [{name: s, material: m, wait: 10 deg}]", ["samples[0].wait", '"deg"', "min"]),
        (SMALLEST + "conditions: {lamp_change: 0.2 s}", ["conditions.lamp_change", '"s"', "%"]),
        (SMALLEST + "conditions: {lamp_change: 200 %}", ["conditions.lamp_change", "less than 1"]),
        (SMALLEST + "conditions: {lamp_warm: 2 h}", ["conditions", "7200 s", "3600 s"]),
        (SMALLEST + "conditions: {lamp_is_warm: 2 h}", ["conditions.lamp_is_warm", 'did you mean "lamp_warm"']),
        (SMALLEST + "resolution: {mode: fine}", ["resolution.mode", "dynamic", "uniform"]),
        (SMALLEST + "resolution: {points: 0}", ["resolution.points", "1"]),
        (SMALLEST + "resolution: {time: 0 s}", ["resolution.time", "greater than 0"]),
        (SMALLEST + "resolutoin: {}", ["resolutoin", 'did you mean "resolution"']),
        (SMALLEST + "name: b", ["line 4", '"name" is given twice']),
        ("name: [unclosed", ["line", "YAML"]),
        ("- name: a", ["a mapping", "a list"]),
        ("", ["a mapping", "nothing"]),
    ],
)
def test_a_mistake_gets_one_line_with_file_place_and_remedy(tmp_path, text, words):
    with pytest.raises(CampaignError) as caught:
        load(tmp_path, text)
    message = str(caught.value)
    assert "\n" not in message
    assert "campaign.yaml" in message
    for word in words:
        assert word in message


@pytest.mark.parametrize("sample", ["{name: S1, material: sample-1, repeats: -1}", "{name: S1}"])
def test_one_faulty_sample_is_one_fault(tmp_path, sample):
    with pytest.raises(CampaignError, match=r", line 3: samples\[0\]\.") as caught:
        load(tmp_path, f"name: a\nsamples:\n  - {sample}\n")
    assert "more fault" not in str(caught.value)
    with pytest.raises(CampaignError, match=r", lines 3 and 4: samples\[0\].*\(and 1 more fault\)"):
        load(tmp_path, f"name: a\nsamples:\n  - {sample}\nrounds: 0\n")


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(CampaignError, match=r"nowhere\.yaml"):
        load_campaign(tmp_path / "nowhere.yaml")


def test_json_is_read_like_yaml(tmp_path):
    path = tmp_path / "campaign.json"
    path.write_text(json.dumps({"name": "First light", "samples": [{"name": "Sample 1", "material": "sample-1"}]}))
    assert load_campaign(path) == load(tmp_path, SMALLEST)


def test_a_changed_campaign_has_another_hash_and_a_reworded_one_has_not(tmp_path):
    campaign = load(tmp_path, SMALLEST)
    spelled_out = load(tmp_path, SMALLEST + "incident: {start: 0 deg, stop: 80, step: 10}\nseed: 0\n")
    assert spelled_out.hash == campaign.hash
    assert load(tmp_path, SMALLEST + "seed: 1").hash != campaign.hash
    assert load(tmp_path, SMALLEST + "resolution: {tolerance: 0.03}").hash != campaign.hash


def test_a_certificate_that_moved_to_another_folder_does_not_forbid_a_resume(tmp_path):
    with_certificate = load(tmp_path, SMALLEST + "reference: {certificate: panel.csv}")
    assert with_certificate.reference.certificate == str(tmp_path / "panel.csv")
    assert with_certificate.hash == load(tmp_path, SMALLEST).hash


def test_who_overrides_a_certificate_may_be_decided_when_all_is_measured(tmp_path):
    overridden = load(tmp_path, SMALLEST + "reference: {override: {name: ' A. Smith ', reason: It is on its way.}}")
    assert (overridden.reference.override.name, overridden.reference.override.reason) == (
        "A. Smith",
        "It is on its way.",
    )
    assert overridden.hash == load(tmp_path, SMALLEST).hash


def test_what_is_measured_beside_the_points_is_part_of_the_campaign(tmp_path):
    campaign = load(tmp_path, SMALLEST)
    assert (campaign.stray_light, campaign.monitor.every, campaign.homogeneity) == (True, 600.0, None)
    without = load(tmp_path, SMALLEST + "monitor: null\n")
    assert without.monitor is None
    changes = (
        "monitor: {every: 5 min}",
        "stray_light: false",
        "homogeneity: {}",
        "integration: {signal_to_noise: 100}",
    )
    hashes = {load(tmp_path, SMALLEST + change).hash for change in changes}
    assert len(hashes | {campaign.hash, without.hash}) == len(changes) + 2


TWICE = "name: a\nsamples:\n  - {name: A, material: m, repeats: 2}\n  - {name: B, material: m}\n"


def names(campaign):
    return [name for name, _ in campaign.series]


def test_repeats_are_counted_on_from_round_to_round_and_a_single_measurement_has_no_number(tmp_path):
    assert names(load(tmp_path, TWICE)) == ["reference", "A #1", "A #2", "B"]
    rounds = load(tmp_path, TWICE + "rounds: 2\nreference: {every_round: true}")
    first, second = ["reference #1", "A #1", "A #2", "B #1"], ["reference #2", "A #3", "A #4", "B #2"]
    assert names(rounds) == first + second
    assert names(load(tmp_path, TWICE + "rounds: 2")) == ["reference", *first[1:], *second[1:]]


def test_a_campaign_that_was_begun_before_anything_could_be_repeated_goes_on(tmp_path):
    campaign = load(tmp_path, SMALLEST)
    content = campaign.model_dump(mode="json")
    for later in ("rounds", "conditions"):
        del content[later]
    for later in ("certificate", "override", "every_round"):
        del content["reference"][later]
    for later in ("repeats", "wait"):
        del content["samples"][0][later]
    del content["resolution"]["scene"]
    assert campaign.hash == hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()


def test_how_often_is_part_of_what_is_measured_and_when_is_not(tmp_path):
    def of(more, sample=""):
        return load(tmp_path, SMALLEST.replace("sample-1}", f"sample-1{sample}}}") + more).hash

    hashes = {of(""), of("rounds: 2"), of("rounds: 2\nreference: {every_round: true}"), of("", ", repeats: 2")}
    assert len(hashes) == 4
    assert of("", ", wait: 10 min") == of("conditions: {lamp_warm: 5 min, lamp_change: 0.2 %}") == of("")


def test_a_change_of_the_lamp_may_be_said_in_per_cent(tmp_path):
    said = load(tmp_path, SMALLEST + "conditions: {lamp_change: 0.2 %}").conditions
    assert said.lamp_change == pytest.approx(0.002)
    assert load(tmp_path, SMALLEST + "conditions: {lamp_change: 0.002}").conditions == said


def test_a_sample_has_a_diameter_so_that_a_footprint_can_leave_it(tmp_path):
    campaign = load(tmp_path, "name: a\nsamples: [{name: s, material: m, diameter: 2.5 cm}, {name: t, material: m}]")
    assert [sample.diameter for sample in campaign.samples] == [25.0, 50.0]
    assert campaign.reference.diameter == 50.0


def test_a_range_that_touches_the_blocked_sector_is_measured_at_its_edge(tmp_path):
    assert load(tmp_path, SMALLEST + "incident: [20]\noutgoing: {start: -24, stop: -15}").outgoing.stop == -15


def test_canonical_json_reloads_to_the_same_campaign(tmp_path):
    campaign = load(tmp_path, SMALLEST + "incident: [0, 0.5 rad]\nintegration: {maximum: 0.1 s}")
    assert Campaign.model_validate_json(campaign.canonical_json) == campaign
