"""Tests of the report: values that make grasps fail are identified, others are not, and the page
matches the lines."""

import json
import re

import numpy as np
import pytest
from scipy.stats import mannwhitneyu

from mjtactile.core.scenario import Scenario
from mjtactile.evaluate import report, store
from mjtactile.evaluate.episodes import Episode
from mjtactile.evaluate.parameter_sensitivity import against, flat, measures
from mjtactile.evaluate.run import write_report
from mjtactile.evaluate.statistics import summarise
from mjtactile.evaluate.worst_episodes import render, worst
from tests.pages import Balanced


def lines(count=300, controller="gentle", seed=0):
    """Create lines: heavy objects are dropped, tilt shifts the error of the held force, noise has
    no effect."""
    rng = np.random.default_rng(seed)
    mass, tilt, noise = rng.uniform(-50, 50, (3, count))
    held = mass < 30
    return [
        {
            "episode": k,
            "controller": controller,
            "object": ("egg", "vial")[k % 2],
            "seed": k,
            "outcome": "held" if held[k] else "dropped",
            "reason": None if held[k] else f"too heavy: it weighs {mass[k]:.2g} N",
            "phases": "approach > lift",
            "peak_force_true_N": 0.7,
            "break_force_N": 2.0,
            "hold_force_true_N": 0.6,
            "hold_force_N": 0.6 + 1e-4 * tilt[k],
            "slip_mm_true": 0.1,
            "rerun_command": f"mjtactile grasp --seed {k}",
            "randomized": {
                "object.mass_percent": mass[k],
                "left.camera_tilt_deg": [tilt[k], 0.0, 0.0],
                "left.noise_percent": noise[k],
                "left.missing_markers": [3] * (k % 3),
                "random.shape": ("box", "egg")[k % 2],
            },
        }
        for k in range(count)
    ]


def test_only_the_parameter_that_causes_failures_is_significant():
    found = against(lines())
    by_name = {item["name"]: item for item in found}
    assert found[0]["name"] == "object.mass_percent" and [
        item["name"] for item in found if item["stands_out"]
    ] == [found[0]["name"]]
    heavy = found[0]["bins"]
    assert (
        [item["success"] for item in heavy[:3]] == [1.0] * 3
        and heavy[4]["success"] == 0
        and heavy[4]["from"] > 25
    )
    assert sum(item["episodes"] for item in heavy) == 300
    assert by_name["left.camera_tilt_deg.x"]["correlation"]["force_error_N"] == pytest.approx(1.0)
    # 2.6 sd of 300 pairs
    assert abs(by_name["left.noise_percent"]["correlation"]["force_error_N"]) < 0.15
    assert "left.camera_tilt_deg.y" not in by_name  # it did not vary
    assert [item["value"] for item in by_name["random.shape"]["bins"]] == [
        "box",
        "egg",
    ] and by_name["random.shape"]["p"] is None
    assert [item["value"] for item in by_name["left.missing_markers"]["bins"]] == [0.0, 1.0, 2.0]
    table = lines()
    masses = np.array([flat(line)["object.mass_percent"] for line in table])
    held = np.array([line["outcome"] == "held" for line in table])
    assert (
        found[0]["p"] == pytest.approx(2 * mannwhitneyu(masses[held], masses[~held]).pvalue)
        and not found[0]["both_ways"]
    )


def test_a_parameter_with_failures_at_both_ends_is_significant():
    table = lines(100)
    for line in table:
        line["outcome"] = (
            "dropped" if abs(line["randomized"]["left.noise_percent"]) > 40 else "held"
        )
    first = against(table)[0]
    assert (
        first["name"] == "left.noise_percent"
        and first["stands_out"]
        and first["both_ways"]
        and first["p"] < 1e-6
    )


def test_random_failures_are_not_significant():
    """Outcomes are independent of five values: in 5 % of such reports a value is significant."""
    rng = np.random.default_rng(3)
    observed = 0
    for seed in range(40):
        table = lines(60, seed=seed)
        for line, held in zip(table, rng.permutation([True] * 50 + [False] * 10), strict=True):
            line["outcome"] = "held" if held else "dropped"
        observed += any(item["stands_out"] for item in against(table))
    assert observed <= 6  # 2 expected; 3 sd more


def test_both_controllers_have_equal_bins_without_errors():
    first = lines()
    second = lines(controller="other")
    second[0] |= {
        "outcome": "error",
        "hold_force_N": None,
        "peak_force_true_N": None,
        "slip_mm_true": None,
    }
    summary = summarise([*first, *second])
    (a, b) = (summary["controllers"][name]["randomized"][0]["bins"] for name in ("gentle", "other"))
    assert [item["from"] for item in a] == [item["from"] for item in b]
    assert (
        sum(item["episodes"] for item in b) == 299 and measures(second[0])["force_error_N"] is None
    )
    assert summary["controllers"]["gentle"]["peak_to_break_ratio"]["max"] == pytest.approx(0.35)
    json.dumps(summary)


def test_worst_episodes_contain_every_kind():
    table = lines(40)
    for k, line in enumerate(table):
        line["outcome"] = "dropped" if k < 12 else "held"
    table[20]["outcome"] = "crushed"
    table[21]["outcome"] = "error"
    table[30]["slip_mm_true"] = 4.0
    chosen = worst(table, 6)
    kinds = [(line["object"], line["outcome"]) for line in chosen]
    assert {("egg", "dropped"), ("vial", "dropped"), ("egg", "crushed")} <= set(kinds) and len(
        chosen
    ) == 6
    # 12 dropped, one crushed, one error: at most ten; of held episodes only, a tenth
    held = [line for line in table if line["outcome"] == "held"]
    assert len(worst(table, None)) == 10 and len(worst(held, None)) == 3
    # errors, then near failures
    assert worst(table, 15)[13]["episode"] == 21 and worst(table, 15)[14]["episode"] == 30


def test_the_page_is_complete_and_agrees_with_the_lines():
    table = lines() + lines(controller="a<b")
    manifest = {
        "options": {"controllers": ["gentle", "a<b"], "count": 300, "scenario": {}},
        "versions": {"mjtactile": "1"},
    }
    page = Balanced(report.page(manifest, table, worst(table, 2), {}))
    eggs = sum(line["outcome"] == "dropped" and line["object"] == "egg" for line in table) // 2
    assert "a<b holds 0.0 points more than gentle in the same 300" in page.text
    assert re.search(rf"too heavy: it weighs [\d.]+ N{eggs}", page.text)  # equal reasons together
    assert (
        "stands out" in page.text
        and "object.mass_percent" in page.text
        and "mjtactile grasp --seed" in page.text
    )


def test_images_of_the_worst_episodes_are_in_the_page(tmp_path, monkeypatch):
    kept = store.Store(
        tmp_path,
        {
            "options": {"controllers": ["gentle"], "objects": ["egg"], "scenario": {"seed": 3}},
            "versions": {},
            "files": {},
        },
        resume=False,
    )
    table = lines(2)
    for line in table:
        kept.add(line)
    requested = []

    def image(episode, folder):
        requested.append(episode)
        folder.mkdir(parents=True)
        (folder / "summary.png").write_bytes(b"png")
        return folder / "summary.png"

    monkeypatch.setattr("mjtactile.evaluate.worst_episodes.render", image)
    path = write_report(tmp_path, 1)
    assert requested == [
        Episode(requested[0].index, Scenario(controller="gentle", seed=3 + requested[0].index))
    ]
    assert 'src="data:image/png;base64,cG5n"' in path.read_text()


@pytest.mark.slow
def test_a_worst_episode_is_run_again_and_rendered(tmp_path):
    from tests.emulated_host import controller_text

    (tmp_path / "quick.py").write_text(controller_text(hold=0.1))
    scenario = Scenario(
        object="random:3",
        controller=str(tmp_path / "quick.py"),
        seed=3,
        effects="-mesh,-pipeline",
        randomization="default",
    )
    episode = Episode(0, scenario)
    image = render(episode, tmp_path / "worst")
    assert image is not None and image.read_bytes()[:4] == b"\x89PNG"
    assert "--seed 3" in Balanced(image.with_suffix(".html").read_text()).text  # and its page
    assert '"randomized"' in (tmp_path / "worst" / "recording" / "log.jsonl").read_text()
    (tmp_path / "bad.py").write_text("def step(observation):\n    return None\n")
    bad = Scenario(controller=str(tmp_path / "bad.py"), seed=3, effects="-mesh,-pipeline")
    assert render(Episode(0, bad), tmp_path / "other") is not None


def test_plots_without_failures_are_folded():
    """Without a failure every bin has 100 %: all plots against randomized values are folded."""
    table = [line | {"outcome": "held"} for line in lines()]
    page = report.page(
        {"options": {"controllers": ["gentle"], "scenario": {}}, "versions": {}}, table, [], {}
    )
    folded = page.partition("values with 100 % success in each bin</summary>")[2]
    assert folded.partition("</details>")[0].count("<svg") >= 3
    assert "100 % success in each bin" not in report.page(
        {"options": {"controllers": ["gentle"], "scenario": {}}, "versions": {}},
        [line | {"outcome": "dropped"} for line in table],
        [],
        {},
    )
