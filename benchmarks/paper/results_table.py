"""Results of the experiments in words and one table, next to the paper's numbers."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

_PAPER = (
    "Mkhitarian & Burschka, *Vision Based Haptic Multisensor for Manipulation of Soft, Fragile "
    "Objects*"
)
Row = tuple[str, ...]


def table(results: Mapping[str, Any]) -> str:
    """Return one Markdown table for each kind of experiment that ran."""
    parts = [
        _markdown(head, rows)
        for head, names in _TABLES.items()
        if (
            rows := [row for name in names if name in results for row in _ROWS[name](results[name])]
        )
    ]
    return "\n\n".join(parts) + "\n"


def _markdown(head: Row, rows: list[Row]) -> str:
    lines = [head, ("---",) * len(head), *rows]
    return "\n".join(f"| {' | '.join(cells)} |" for cells in lines)


def _fig5a(result: Mapping[str, Any]) -> list[Row]:
    rows = []
    for run in result["runs"]:
        low = run["steps"][0]["cell_N"]
        high = run["steps"][-1]["cell_N"]
        claim = "0.04" if run["valve"] == "closed" else "-"
        unknown = f" ({run['unknown']} of {len(run['steps'])} unknown)" if run["unknown"] else ""
        rows.append(
            (
                f"`{run['sensor']}`, valve {run['valve']}, {low:.2f} to {high:.2f} N",
                f"{run['error_ours_N']:.3f}{unknown}",
                f"{run['error_paper_N']:.3f}",
                claim,
            )
        )
    return rows


def _fig5b(result: Mapping[str, Any]) -> list[Row]:
    rows = [
        (
            f"5b: {name}: residual of a line / of a parabola, rms",
            f"{1e3 * result[name]['linear_rms_N']:.0f} / "
            f"{1e3 * result[name]['parabola_rms_N']:.0f} mN",
            claim,
        )
        for name, claim in (("solid", "a line"), ("sponge", "a parabola"))
    ]
    law = result["sponge_law"]
    return [
        *rows,
        (
            "5b: law of the sponge without the membrane, F = K d + B d^2: K, B (true)",
            f"{law['stiffness_N_m']:.0f} N/m, {1e-6 * law['stiffening_N_m2']:.2f} N/mm^2 "
            f"({law['stiffness_true_N_m']:.0f}, {1e-6 * law['stiffening_true_N_m2']:.2f})",
            '"possible"',
        ),
    ]


def _fig5c(result: Mapping[str, Any]) -> list[Row]:
    return [
        (f"5c: {name}, driven in: mean force error over time", f"{c['error_N']:.3f} N", "no number")
        for name, c in result.items()
    ]


def _fig6(result: Mapping[str, Any]) -> list[Row]:
    summary = result["summary"]
    returned = summary["mean_as_returned_mm"]
    return [
        (
            f"6: mean center error of {summary['circles']:.0f} circles, nearer of two poses "
            "(returned pose)",
            f"{summary['mean_mm']:.4f} mm ({returned:.4f})",
            "0.39 mm",
        ),
        ("6: largest center error, nearer of two poses", f"{summary['worst_mm']:.3f} mm", "-"),
    ]


def _fig7(result: Mapping[str, Any]) -> list[Row]:
    return [
        (
            f"7: {name}: estimate (load cell)",
            f"{d['force_N']:.3f} ({d['cell_N']:.3f}) N",
            "image only",
        )
        for name, d in result.items()
    ]


def _air(result: Mapping[str, Any]) -> list[Row]:
    return [
        (
            f"{r['supply_kPa']:g}",
            f"{r['air_mL']:.0f}",
            r["valve"],
            f"{r['stiffness_N_mm']:.3f}",
            f"{1e3 * r['noise_N']:.1f}",
        )
        for r in result["runs"]
    ]


_ROWS = {
    "fig5a": _fig5a,
    "fig5b": _fig5b,
    "fig5c": _fig5c,
    "fig6": _fig6,
    "fig7": _fig7,
    "air": _air,
}
_TABLES: dict[Row, tuple[str, ...]] = {
    (
        "5a: force error, N, cylinder, 1 mm steps",
        "ours",
        "dF = c dA, c fitted to these points",
        "paper",
    ): ("fig5a",),
    ("experiment", "ours", "paper"): ("fig5b", "fig5c", "fig6", "fig7"),
    (
        "amount of air: supply, kPa",
        "air, mL",
        "valve",
        "force for the first mm, N",
        "noise-equivalent force, mN",
    ): ("air",),
}
"""Headings of the tables, and the experiments in each."""

_TEXT = {
    "fig5a": (
        "**Fig. 5a.** A cylinder (6 mm) driven in by 1 mm steps. dF = c dA is worse than claimed: "
        "with the valve closed, area grows with the square of the depth; with the valve open, it "
        "shrinks.",
    ),
    "fig5b": (
        "**Fig. 5b.** The same face, rigid and on a sponge. Left, as in the paper: membrane and "
        "object in series. Right: less the observed membrane displacement.",
    ),
    "fig5c": ("**Fig. 5c.** Driven in at 2 mm/s, then held.",),
    "fig6": (
        "**Fig. 6.** 16 circles in random poses. Other methods: "
        "[marker accuracy](benchmarks/perception.md).",
    ),
    "fig7": ("**Fig. 7.** Three objects: camera image, estimated membrane, nodal forces.",),
    "air": (
        "**Amount of air.** More pressure (above 1 kPa) or less air increases the force of the "
        "first millimetre, as claimed, but not the motion resolution.",
    ),
}


def page(results: Mapping[str, Any], images: str) -> str:
    """Return the page docs/validation/paper.md."""
    parts = [
        "# Experiments of the paper",
        f'**Question.** Are accuracy and claims of {_PAPER} ("paper") reproduced?',
        "**Setup.** Simulated sensors without calibration; the pipeline gets rendered images only "
        '(noise 2 DN, blur 0.7 px). "Load cell": simulated contact force.',
        table(results).strip(),
        "**Reproduce:** `mjtactile experiments --page docs/validation/paper.md`",
    ]
    for name in results:
        parts += [*_TEXT[name], f"![{name}]({images}/{name}.png)"]
    return "\n\n".join(parts) + "\n"
