"""`build`: all files of an output folder, computed and checked before the first is written."""

from __future__ import annotations

import io
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mjtactile.core.design import SensorDesign
from mjtactile.core.errors import InputError, MjtactileError
from mjtactile.fabrication import manual, mesh, part_renderings, print_templates
from mjtactile.fabrication.camera_check import Optics, plan_camera
from mjtactile.fabrication.drawing_pages import write_pdf, write_png, write_svg
from mjtactile.fabrication.dxf_file import write_dxf
from mjtactile.fabrication.housing_layout import Layout
from mjtactile.fabrication.layered_solid import Contour, Part, circle, crossing, plate
from mjtactile.fabrication.manufacturability import glass_limit
from mjtactile.fabrication.marker_positions import (
    MembraneState,
    press_depth,
    simulate,
    simulate_largest_loads,
)
from mjtactile.fabrication.parts import PEG, RUBBER, make_parts, pegs
from mjtactile.fabrication.pressure_loads import PressureLoads
from mjtactile.fabrication.purchased_parts import Hardware
from mjtactile.fabrication.step_file import write_step
from mjtactile.report.figures import new_figure
from mjtactile.sim.rendering.renderer import Renderer

_VOLUME = 2e-3  # tolerance as a fraction of a part's volume, since chords replace arcs
_SEPARATE = (
    ("clamp_ring", "frame"),
    ("glass", "frame"),
    ("camera", "led_ring"),
    ("camera", "glass"),
)


@dataclass(frozen=True, eq=False)
class Build:
    """`files` by their path in the folder, and `report` for `--json`."""

    files: dict[str, bytes]
    report: dict[str, Any]


def build(
    design: SensorDesign,
    hardware: Hardware,
    source: str,
    text: str,
    notify: Callable[[str], None] = lambda _: None,
    states_of: Callable[..., list[MembraneState]] = simulate,
    load_states_of: Callable[..., list[MembraneState]] = simulate_largest_loads,
) -> Build:
    """Compute all files for `design`, read from `source` with `text`. Raises InputError."""
    mesh.require_libraries()
    layout = Layout.of(design, hardware, source)
    parts = make_parts(layout)
    solids = {name: mesh.solid_of(part) for name, part in parts.items()}
    _check_parts(parts, solids)
    states = states_of(design, hardware, source, notify)
    optics = plan_camera(design, hardware, states, source)
    loads = PressureLoads.of(design, states, load_states_of(design, notify))
    glass_limit(design, loads.highest.gauge_pressure, loads.highest.name).check(source)
    notify("drawing")
    gap = min(solids[a].min_gap(solids[b], 5.0) for a, b in _SEPARATE)
    checked = manual.checks(layout, optics, press_depth(design, hardware), states, gap, loads)
    images = _renderings(layout, optics, parts)
    files = {
        "README.md": manual.readme(layout, parts, checked, source).encode(),
        "assembly.md": manual.assembly(layout, optics, list(images)).encode(),
        "bill.md": manual.bill(layout, optics, loads).encode(),
        "sensor.toml": text.encode(),
    }
    files |= _papers(layout) | {f"pictures/{name}.png": png for name, png in images.items()}
    for name, part in parts.items():
        if part.make:
            files[f"cad/{name}.stl"] = mesh.write_stl(mesh.triangles_of(solids[name]))
            files[f"cad/{name}.step"] = write_step(part).encode()
    report = {
        "sensor": design.name,
        "checks": checked,
        "optics": asdict(optics) | {"states": [s.name for s in states]},
        "parts": {
            name: {"size_mm": part.size, "volume_mm3": part.volume}
            for name, part in parts.items()
            if part.make
        },
    }
    return Build(files, report)


def _check_parts(parts: dict[str, Part], solids: dict[str, Any]) -> None:
    """Check that all solids are closed, have their closed-form volume and do not intersect."""
    for name, part in parts.items():
        if crossing(part):
            raise _collision(f"holes and edges of the {name} would meet")
        volume = solids[name].volume()
        if solids[name].is_empty() or abs(volume - part.volume) > _VOLUME * part.volume + 0.05:
            raise MjtactileError(
                f"fabricate: the {name} has {volume:.3f} mm3 instead of {part.volume:.3f}: "
                "its holes meet its edges"
            )
    for first, other, volume in mesh.overlaps(solids):
        raise _collision(f"the {first} and the {other} would intersect by {volume:.3g} mm3")


def _collision(problem: str) -> InputError:
    action = "use other camera or lens dimensions (--camera-holes-mm, --lens-mm, --pupil-mm)"
    return InputError(f"{problem}; {action}", source="fabricate", field="parts")


def _papers(layout: Layout) -> dict[str, bytes]:
    pages = print_templates.marker_pages(layout)
    board = print_templates.board_page(layout.design)
    svgs = {
        "markers": pages[0],
        "stencil": pages[1],
        "board": board,
        "led_ring": print_templates.led_page(layout),
        "gasket": print_templates.cut_page(layout),
    }
    pdfs = {"markers": pages, "board": [board]}
    fiducials = print_templates.fiducial_page(layout)
    if fiducials is not None:
        svgs["fiducials"] = fiducials
        pdfs["fiducials"] = [fiducials]
    images = {f"{name}.svg": write_svg(rubber).encode() for name, rubber in svgs.items()}
    images |= {f"{name}.dxf": write_dxf(svgs[name]).encode() for name in svgs if name != "board"}
    return images | {f"{name}.pdf": write_pdf(pages) for name, pages in pdfs.items()}


def _renderings(layout: Layout, optics: Optics, parts: dict[str, Part]) -> dict[str, bytes]:
    """Render the images of the steps, by name; none without matplotlib."""
    edge = Contour(layout.outer_x + 12, layout.outer_y + 12)
    rubber = plate(0.0, 0.6, edge, [circle(PEG, x, y) for x, y in pegs(layout)])
    parts = {**parts, manual.RUBBER_SHEET: Part(manual.RUBBER_SHEET, (rubber,), RUBBER, make=False)}
    solids = {name: mesh.solid_of(part, mesh.COARSE) for name, part in parts.items()}
    found: dict[str, bytes | None] = {}
    for step in manual.steps_of(layout):
        if step.parts:
            shifts = dict.fromkeys(step.parts, 0.0)
            if not step.cut:
                shifts = part_renderings.explode(parts, step.parts)
            items = part_renderings.bodies_of(parts, solids, shifts)
            name = f"{step.figure}.png"
            found[step.figure] = part_renderings.save_png(items, name, **step.view)
    found["camera_view"] = _camera_view(layout.design, optics)
    half = print_templates.page_size(layout)
    found["print"] = write_png(print_templates.marker_pages(layout)[0], half[0] + 2, half[1] + 2)
    fiducials = print_templates.fiducial_page(layout)
    if fiducials is not None:
        found["fiducials"] = write_png(fiducials, layout.outer_x, layout.outer_y)
    return {name: png for name, png in found.items() if png is not None}


def _camera_view(design: SensorDesign, optics: Optics) -> bytes | None:
    """Return the expected camera view of the flat membrane, with the LED reflections marked."""
    figure = new_figure("camera_view.png", (6.4, 4.8), dpi=100)
    if figure is None:
        return None
    normals = np.tile([0.0, 0.0, 1.0], (design.markers.count, 1))
    image = Renderer(design, seed=0).render(design.markers.p_SM, normals, 0.0)
    axes = figure.subplots()
    axes.imshow(image.pixels, cmap="gray", vmin=0, vmax=255)
    axes.plot(*optics.mirrors.T, "o", mfc="none", mec="#d1571b", ms=16)
    width, height = design.camera.width, design.camera.height
    axes.set(xlim=(-0.5, width - 0.5), ylim=(height - 0.5, -0.5), xlabel="u, px", ylabel="v, px")
    out = io.BytesIO()
    figure.savefig(out, format="png", metadata={"Software": None})
    return out.getvalue()


def write(files: dict[str, bytes], folder: Path) -> None:
    """Write all files, or none. Raises InputError if the folder is not writable."""
    done: list[Path] = []
    try:
        for name, content in files.items():
            path = folder / name
            path.parent.mkdir(parents=True, exist_ok=True)
            done.append(path)
            path.write_bytes(content)
    except OSError as error:
        for path in done:
            path.unlink(missing_ok=True)
        raise InputError(
            f"cannot be written: {error.strerror}", source=folder, field="--out"
        ) from error
