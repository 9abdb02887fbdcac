"""Plots of a study: maps of the sensing surface, the Pareto front, and a web page for one file."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from mjtactile.report import html

# key of a position's result, label, unit
MAPS = (
    ("force_sd_mN", "sd of the force", "mN"),
    ("position_sd_mm", "sd of the force position", "mm"),
    ("edge_sd_mm", "sd of an edge position", "mm"),
)
WORDS = {
    "detection_mN": ("detection threshold of the pipeline", "mN"),
    "detection_by_noise_mN": ("detection threshold by pixel noise alone", "mN"),
    "force_sd_mN": ("sd of the force, all error sources included", "mN"),
    "force_noise_mN": ("sd of the force from image to image", "mN"),
    "position_sd_mm": ("sd of the force position", "mm"),
    "edge_sd_mm": ("sd of an edge position", "mm"),
    "smallest_radius_mm": ("smallest ball whose radius is estimated to 25 %", "mm"),
    "force_max_N": ("largest force of a 10 mm ball", "N"),
}


def number(value: float | None) -> str:
    """Format a predicted number with two digits; "-" if it is unknown.

    Measured errors are 0.8 to 1.7 times the predicted sd: further digits have no meaning.
    """
    if value is None or not np.isfinite(value):
        return "-"
    return f"{float(f'{value:.2g}'):g}"


def plot_face(figure: Any, study: Mapping[str, Any]) -> None:
    """Plot the maps of the sensing surface.

    Args:
        figure: Empty, of matplotlib.
        study: The JSON's object of a study.
    """
    positions = study["face"]
    x = sorted({position["x_mm"] for position in positions})
    y = sorted({position["y_mm"] for position in positions})
    for axes, (key, words, unit) in zip(figure.subplots(1, len(MAPS)), MAPS, strict=True):
        values = np.array([position[key] for position in positions], float).reshape(len(y), len(x))
        artist = axes.pcolormesh(x, y, values, shading="nearest", cmap="viridis_r", vmin=0)
        dark = 0.55 * np.nanmax(values, initial=0.0)
        for row, column in np.ndindex(values.shape):
            value = float(values[row, column])
            colour = "w" if value > dark else "k"
            axes.text(
                x[column], y[row], number(value), ha="center", va="center", fontsize=7, color=colour
            )
        axes.set(title=f"{words}, {unit}", xlabel="x, mm", aspect="equal")
        figure.colorbar(artist, ax=axes, shrink=0.6)
    figure.axes[0].set_ylabel("y, mm")
    figure.suptitle(f"sensor {study['sensor']}: predicted performance at {study['force_N']:g} N")


def page(study: Mapping[str, Any], image: bytes | None) -> str:
    """Write the page of one file.

    Args:
        study: The JSON's object of a study.
        image: The maps, PNG; None: not available.

    Returns:
        HTML.
    """
    title = f"Predicted performance of the sensor {study['sensor']}"
    body = [f"<h1>{title}</h1>", f"<p>Predicted at {study['force_N']:g} N.</p>"]
    performance = study["performance"]
    reached = [
        (words, f"{number(performance[key])} {unit}") for key, (words, unit) in WORDS.items()
    ]
    body.append(html.table(("", "reached"), reached))
    if image is not None:
        body.append(f'<img alt="maps of the face" src="{html.data_uri("image/png", image)}">')
    body.append(f"<p>{image_quality_text(study['image'])}</p>")
    body.append("<h2>Effect of changes</h2><p>Factors relative to the present values.</p>")
    body.append(html.table(("change", *CHANGED.values()), change_rows(study)))
    return html.document(title, body)


CHANGED = {
    "detection_by_noise_mN": "touch by noise",
    "force_sd_mN": "force sd",
    "force_noise_mN": "its noise",
    "position_sd_mm": "position sd",
    "edge_sd_mm": "edge sd",
    "force_max_N": "largest force",
}


def change_rows(study: Mapping[str, Any]) -> list[tuple[str, ...]]:
    """Return a table row for each change with its factors on the predicted performance.

    Args:
        study: The JSON's object of a study.

    Returns:
        Rows of words.
    """
    rows = []
    for change in study["changes"]:
        if change["performance"] is None:
            rows.append((change["change"], change["why_not"], *("" for _ in list(CHANGED)[1:])))
            continue
        factors = [change["performance"][key] / study["performance"][key] for key in CHANGED]
        known = ["-" if not np.isfinite(factor) else f"{factor:.2f}" for factor in factors]
        rows.append((change["change"], *known))
    return rows


def image_quality_text(image: Mapping[str, float]) -> str:
    """Describe the use of the camera image in a sentence."""
    width = 100 * (1 - image["width_used"])
    height = 100 * (1 - image["height_used"])
    longer = 100 * (image["longest_lens"] - 1)
    room = "a longer lens would lose markers"
    if image["longest_lens"] > 1.01:
        room = f"a lens {longer:.0f} % longer would still show every marker, flat and inflated"
    return (
        f"{width:.0f} % of the image width and {height:.0f} % of its height lie outside the "
        f"membrane; {room}."
    )


def plot_front(figure: Any, swept: Mapping[str, Any]) -> None:
    """Plot all designs of a sweep and the Pareto front.

    Args:
        figure: Empty, of matplotlib.
        swept: The JSON's object of a sweep.
    """
    axes = figure.subplots()
    count = _plot_candidates(figure, axes, swept)
    initial = swept["initial"]["performance"]
    if initial is not None:
        axes.plot(initial["force_sd_mN"], initial["edge_sd_mm"], "r*", ms=14, label=swept["sensor"])
    required = swept["requirements"]["edge_mm"]
    if required is not None:
        axes.axhline(required, color="0.6", ls=":", label="required sd of an edge")
    axes.set(
        xlabel=f"sd of a force of {swept['force_N']:g} N, mN",
        ylabel="sd of an edge position, mm",
        xscale="log",
        yscale="log",
        title=f"{count} designs, predicted",
    )
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_formatter("{x:g}")
        axis.set_minor_formatter("{x:g}")
    axes.tick_params(which="minor", labelsize=7)
    axes.grid(alpha=0.3, which="both")
    axes.legend(fontsize=8)


def _plot_candidates(figure: Any, axes: Any, swept: Mapping[str, Any]) -> int:
    """Plot the designs that show edges, with the front marked. Return their number."""
    candidates = [
        candidate
        for candidate in swept["candidates"]
        if np.isfinite(candidate["performance"]["edge_sd_mm"])
    ]
    x = np.array([candidate["performance"]["force_sd_mN"] for candidate in candidates], float)
    y = np.array([candidate["performance"]["edge_sd_mm"] for candidate in candidates], float)
    markers = np.array(
        [candidate["rows"] * candidate["columns"] for candidate in candidates], float
    )
    meets = np.array([candidate["meets"] for candidate in candidates], bool)
    for mask, marker, label in ((meets, "o", "meets all"), (~meets, "x", "misses a requirement")):
        if mask.any():
            artist = axes.scatter(
                x[mask], y[mask], c=markers[mask], marker=marker, s=28, label=label,
                vmin=0, vmax=markers.max(), cmap="viridis",
            )  # fmt: skip
    figure.colorbar(artist, ax=axes, label="markers")  # pyright: ignore[reportPossiblyUnboundVariable]
    on_front = np.array([candidate["on_front"] for candidate in candidates], bool)
    # rings: the front is a surface, as the number of markers counts too
    axes.plot(
        x[on_front],
        y[on_front],
        "o",
        ms=10,
        mfc="none",
        mec="k",
        label="Pareto front (force, edge, markers)",
    )
    return len(candidates)
