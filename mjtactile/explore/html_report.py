"""`explore.html`: the explored surface as a rotatable model, and an image of it; one file that
needs no network."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from mjtactile.core.flags import read_flags
from mjtactile.core.types import Array
from mjtactile.explore.compliance_map import ComplianceMap
from mjtactile.explore.exploration import ExplorationResult
from mjtactile.explore.meshing import mesh_of
from mjtactile.explore.next_best_touch import Mesh
from mjtactile.explore.object_size import principal_sizes
from mjtactile.explore.surface_export import SOFT, colours
from mjtactile.recording.files import write_text
from mjtactile.report.html import document, flag_table, is_known, script_data, table

_EDGE = 1.6e-3  # triangle edge, m; a browser can rotate this mesh smoothly
_UNSURE = 1e-3  # standard deviation of the darkest color, m
_ELEVATION = 12  # deg
_AZIMUTH = -55  # deg
_VIEW = Rotation.from_euler("yz", [-_ELEVATION, _AZIMUTH], degrees=True).apply([1.0, 0.0, 0.0])
_LIGHT = np.array([0.62, -0.45, 0.64])
_STYLE = """#solid{width:100%;height:520px;touch-action:none;border:1px solid #e6e6e6;
box-sizing:border-box;cursor:grab}.hint{color:#666;font-size:13px}"""
_FACTS = (
    ("outcome", "ended", ""),
    ("touches", "touches", ""),
    ("body", "body", ""),
    ("surface_sd_mm", "sd of the surface", "mm"),
    ("surface_error_mm_true", "surface error (ground truth)", "mm"),
    ("size_error_true", "size error (ground truth)", ""),
    ("volume_mL", "volume", "mL"),
    ("area_mm2", "area", "mm\u00b2"),
    ("stiffness_N_m", "stiffness", "N/m"),
    ("stiffness_min_N_m", "minimum stiffness, estimated", "N/m"),
)


def write_page(path: Path, found: ExplorationResult, summary: Mapping[str, Any]) -> None:
    """Write the page of an exploration, with the facts of its JSON summary."""
    mesh = mesh_of(found.surface, _EDGE)
    soft = ComplianceMap.of(found.patches, mesh).by_vertex
    data = {
        "vertices": (1e3 * mesh.vertices).round(2).tolist(),
        "normals": mesh.normals.round(3).tolist(),
        "triangles": mesh.triangles.tolist(),
        "colours": {"stiffness": colours(soft).tolist(), "uncertainty": _sd_colours(mesh).tolist()},
        "words": {
            "stiffness": (
                f"Blue: stiff. Red: deforms by {1e6 * SOFT / 1e3:.0f} mm under 1 N. Gray: "
                "unknown. Dots: touches."
            ),
            "uncertainty": "White: sd up to 0.03 mm. Orange: sd of 1 mm or more. Dots: touches.",
        },
        "touched": [
            {"place": 1e3 * patch.center, "normal": patch.normal} for patch in found.patches
        ],
    }
    page = document(f"{summary.get('object', 'explored')}", _body(data, summary), style=_STYLE)
    write_text(path, page)


def _sd_colours(mesh: Mesh) -> Array:
    """Return the colors (V, 3) of each vertex's uncertainty."""
    low, high = math.log(3e-5), math.log(_UNSURE)
    fraction = np.clip((np.log(np.maximum(mesh.sd, 1e-9)) - low) / (high - low), 0, 1)[:, None]
    mixed = (1 - fraction) * np.array([245, 245, 240]) + fraction * np.array([217, 108, 30])
    return mixed.round().astype(int)


def _body(data: Mapping[str, Any], summary: Mapping[str, Any]) -> Iterator[str]:
    yield f"<h1>{escape(str(summary.get('object', 'an object')))}, reconstructed by touch</h1>"
    rows = [
        [escape(label), escape(_words(summary[key], unit))]
        for key, label, unit in _FACTS
        if is_known(summary.get(key))
    ]
    sizes = zip(summary["size_mm"], summary["size_sd_mm"], strict=True)
    size = " x ".join(f"{value:.1f} \u00b1 {sd:.1f}" for value, sd in sizes)
    yield table([], [*rows, ["size", f"{size} mm"]])
    yield (
        '<p><select id="mode"><option value="stiffness">stiffness</option><option '
        'value="uncertainty">uncertainty</option></select> <span class="hint">drag: rotate; '
        'wheel: zoom</span></p><canvas id="solid"></canvas><p id="readout" '
        'class="hint"></p><noscript>The surface needs JavaScript.</noscript>'
    )
    if summary.get("flags"):
        yield flag_table(read_flags(summary["flags"]))
    yield script_data(data)
    script = (Path(__file__).parent / "page.js").read_text(encoding="utf-8")
    yield f"<script>{script}</script>"


def _words(value: Any, unit: str) -> str:
    if not isinstance(value, float):
        return f"{value} {unit}".strip()
    digits = ".0f" if abs(value) >= 1000 else "#.3g"
    return f"{value:{digits}} {unit}".strip()


def plot(figure: Any, found: ExplorationResult) -> None:
    """Plot stiffness and uncertainty of the surface with the touches, its longest axis up."""
    mesh = mesh_of(found.surface, _EDGE)
    soft = ComplianceMap.of(found.patches, mesh).by_vertex
    views = (
        (colours(soft), "stiffness: blue stiff, red soft"),
        (_sd_colours(mesh), "uncertainty: orange 1 mm"),
    )
    for number, (colour, title) in enumerate(views, 1):
        axes = figure.add_subplot(1, 2, number, projection="3d")
        _paint(axes, mesh, np.asarray(colour) / 255, found)
        axes.set_title(title, fontsize=10)


def _paint(axes: Any, mesh: Mesh, colour: Array, found: ExplorationResult) -> None:
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection

    _, sizes = principal_sizes(mesh)
    up = sizes[:, ::-1]
    up = up * np.array([np.linalg.det(up), 1.0, 1.0])
    corners = 1e3 * (mesh.vertices[mesh.triangles] @ up)
    normal = mesh.normals[mesh.triangles].mean(axis=1) @ up
    visible = normal @ _VIEW > 0
    light = 0.5 + 0.5 * np.clip(normal @ _LIGHT, 0, 1)
    faces = (light[:, None] * colour[mesh.triangles].mean(axis=1))[visible]
    axes.add_collection3d(
        Poly3DCollection(corners[visible], facecolors=faces, edgecolors=faces, lw=0.2, zorder=1)
    )
    for touch, patch in enumerate(found.patches):
        if patch.normal @ up @ _VIEW > 0.1:
            position = 1e3 * (patch.center + 1e-3 * patch.normal) @ up
            axes.scatter(*position, s=14, c="k", depthshade=False, zorder=3)
            axes.text(*position, f" {touch + 1}", fontsize=8, zorder=4)
    low, high = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
    center = (low + high) / 2
    half = float((high - low).max()) / 2
    limits = zip(("xlim", "ylim", "zlim"), center - half, center + half, strict=True)
    axes.set(**{name: (start, end) for name, start, end in limits})
    axes.set_box_aspect((1, 1, 1), zoom=0.88)  # leaves room for the unit of the vertical axis
    axes.computed_zorder = False
    axes.set(xlabel="mm", ylabel="mm", zlabel="mm")
    axes.view_init(elev=_ELEVATION, azim=_AZIMUTH)
