"""What the experiments found, in words and one table: our number beside the paper's."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

_PAPER = (
    "Mkhitarian & Burschka, *Vision Based Haptic Multisensor for Manipulation of Soft, Fragile "
    "Objects*"
)
Row = tuple[str, str, str]


def table(results: Mapping[str, Any]) -> str:
    """One Markdown table over all experiments that ran."""
    rows = [row for name, result in results.items() for row in _ROWS[name](result)]
    return (
        "\n".join(
            [
                "| experiment | ours | paper |",
                "|---|---|---|",
                *(f"| {a} | {b} | {c} |" for a, b, c in rows),
            ]
        )
        + "\n"
    )


def _fig5a(result: Mapping[str, Any]) -> list[Row]:
    rows = []
    for run in result["runs"]:
        low = run["steps"][0]["cell_N"]
        high = run["steps"][-1]["cell_N"]
        label = (
            f"5a: force error, cylinder, 1 mm steps, {low:.2f} to {high:.2f} N, "
            f"`{run['sensor']}`, valve {run['valve']}"
        )
        claim = "0.04 N" if run["valve"] == "closed" else "-"
        unknown = f', {run["unknown"]} of {len(run["steps"])} "unknown"' if run["unknown"] else ""
        rows.append((label, f"{run['error_ours_N']:.3f} N{unknown}", claim))
        rows.append(
            (
                "5a: the same by the paper's dF = c dA, c fitted to these points",
                f"{run['error_paper_N']:.3f} N",
                claim,
            )
        )
    return rows


def _fig5b(result: Mapping[str, Any]) -> list[Row]:
    rows = [
        (
            f"5b: {name}: left by a line / by a parabola, rms",
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
            "5b: the sponge's own law F = K d + B d^2 without the membrane: K, B (true)",
            f"{law['stiffness_N_m']:.0f} N/m, {1e-6 * law['stiffening_N_m2']:.2f} N/mm^2 "
            f"({law['stiffness_true_N_m']:.0f}, {1e-6 * law['stiffening_true_N_m2']:.2f})",
            '"possible"',
        ),
    ]


def _fig5c(result: Mapping[str, Any]) -> list[Row]:
    return [
        (
            f"5c: {name}, driving in: mean error of the force over time",
            f"{c['error_N']:.3f} N",
            "no number",
        )
        for name, c in result.items()
    ]


def _fig6(result: Mapping[str, Any]) -> list[Row]:
    summary = result["summary"]
    rows = [
        (
            "6: error of the circle centres, nearer of two poses, mean over "
            f"{summary['circles']:.0f}",
            f"{summary['mean_mm']:.4f} mm",
            "0.39 mm",
        ),
        ("6: the same, as returned", f"{summary['mean_as_returned_mm']:.4f} mm", "0.39 mm"),
        ("6: worst", f"{summary['worst_mm']:.3f} mm", "-"),
    ]
    for name, method in result["methods"].items():
        mean = method.get("mean_mm", np.nan) if isinstance(method, Mapping) else np.nan
        rows.append((f"6: by {name}", f"{mean:.3f} mm", ""))
    return rows


def _fig7(result: Mapping[str, Any]) -> list[Row]:
    return [
        (f"7: {name}: felt (load cell)", f"{d['force_N']:.3f} ({d['cell_N']:.3f}) N", "a picture")
        for name, d in result.items()
    ]


def _air(result: Mapping[str, Any]) -> list[Row]:
    return [
        (
            f"air: {r['supply_kPa']:g} kPa, {r['air_mL']:.0f} mL, valve {r['valve']}: force for "
            "the first mm; noise-equivalent force",
            f"{r['stiffness_N_mm']:.3f} N; {1e3 * r['noise_N']:.1f} mN",
            '"adjustable"',
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

_TEXT = {
    "fig5a": "**Fig. 5a.** A cylinder (6 mm) driven in by 1 mm at a time; the load cell reads the "
    "true contact force. Ours is the sensing chain's force, nothing calibrated. The paper's dF = c "
    "dA gets its best case: c fitted to the very points it is judged on. It still does worse than "
    "claimed, and the lower row shows why. A dome that is pressed in first loses area at the top "
    "and gains it at the flanks: the two cancel, and with a closed valve the area grows only with "
    "the square of the depth, while the force grows linearly. With the valve open, where the "
    "pressure stays, it even shrinks, and c has the wrong sign. The paper's straight line needs a "
    "membrane that is flat, not inflated. The mesh is finer here than the simulator's default, on "
    "whose vertices, 3.3 mm apart, this face rests at eleven points and is no circle. With 16 "
    "markers it stands between four that see its rim alone: their slopes tell that it is flat.",
    "fig5b": "**Fig. 5b.** The same face, rigid and on a sponge. Left as the paper plots it: "
    "driven depth, membrane and object in series. Even the solid's curve is no line, because the "
    "membrane stiffens; the sponge's parabola is the membrane's as much as its own. Right: where "
    "the membrane stands is seen by the camera, so its share can be taken away; what remains is "
    "the object's own law, and a solid's is a vertical line.",
    "fig5c": "**Fig. 5c.** Driven in at 2 mm/s, one image each 1/30 s, then held.",
    "fig6": "**Fig. 6.** Synthetic images of 16 circles in random poses, with blur 0.7 px and "
    "noise 2 DN, by a renderer that shares nothing with the detector.",
    "fig7": "**Fig. 7.** Three objects: the camera's image, the reconstructed membrane, the force "
    "on each node (tangential forces with a minus sign, as in the paper).",
    "air": "**Amount of air.** The claim holds for pressures above about 1 kPa and for the amount "
    "of air: more of the one, or less of the other, makes a touch meet more force in the first "
    "millimetre. More pressure makes the noise grow as fast, so that no finer motion is told; less "
    "air changes it little. The finest force is felt with the valve open, which keeps a known "
    "pressure; the finest motion with the valve closed.",
}


def page(results: Mapping[str, Any], images: str) -> str:
    """The page docs/validation/paper.md."""
    parts = [
        "# The paper's experiments again",
        "Made by `mjtactile experiments --page docs/validation/paper.md`; nothing here is "
        f'typed in. "Paper" is {_PAPER}. Simulated sensors, the chain sees only '
        "rendered images (noise 2 DN, blur 0.7 px).",
        table(results),
    ]
    for name in results:
        parts += [_TEXT[name], f"![{name}]({images}/{name}.png)"]
    return "\n\n".join(parts) + "\n"
