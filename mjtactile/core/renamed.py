"""Names that version 0.2.0 changed: keys of files, options, columns of recordings.

The readers of files and the command line refuse an old name with the new one in the message. They
read an old value with a warning. A recording keeps its old names permanently, so its reader
translates them.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

KEYS: Mapping[str, str] = {
    # tasks
    "to_g": "final_mass_g",
    "hand_over": "handover",
    "need_most_N": "required_grip_max_N",
    "break_share_of_need": "break_force_factor",
    "break_least_N": "break_force_min_N",
    "let_go_within_s": "release_within_s",
    "fall_mm": "drop_max_mm",
    "bump_N_s": "impact_max_N_s",
    "upright_deg": "tilt_max_deg",
    "begin_s": "start_s",
    "last_s": "duration_s",
    # sensors
    "heat_ratio": "polytropic_exponent",
    "heat_exchange_s": "thermal_time_constant_s",
    "rim_mm": "wall_mm",
    "supply_gauge_kPa": "supply_pressure_kPa",
    "softening_share": "mullins_fraction",
    "softening_kJ_m3": "mullins_energy_kJ_m3",
    "ground_mm": "quiet_zone_mm",
    "step_mm": "wall_setback_mm",
    "places_mm": "positions_mm",
    # rigs and ranges of domain randomization
    "opening_part_mm": "jaw_offset_mm",
    "hold_s": "host_loss_hold_s",
    "warming_K_min": "temperature_drift_K_min",
    "valve_zero_Pa": "pressure_offset_Pa",
    "knock_px": "image_shift_px",
    "turn_deg": "rotation_deg",
    "zoom_percent": "scale_percent",
    "law": "transmission",
    "specimen": "as_built",
    "judge": "scoring_version",
    # sections of tasks, lights of sensors, scenarios
    "told": "goal",
    "happens": "disturbance",
    "counts": "success",
    "falloff": "vignetting",
    "vary": "randomization",
    "shapes": "contact_shapes",
    # error models of a sensing pipeline
    "said": "reported_sd",
    # cases of bench references
    "felt": "estimate",
    "least": "tolerance_min",
}
"""File key before 0.2.0 to file key now."""

VALUES: Mapping[str, Mapping[str, str]] = {"surface": {"pane": "glass"}}
"""File key to its values in earlier versions and those now. Old values are read with a warning."""

SETTINGS: Mapping[str, str] = {
    "body.film_sd": "contact_shape.membrane_sd",
    "body.log_body": "contact_shape.log_shape",
    "body.place_sd": "contact_shape.position_sd",
    "body.place_sd_sharp": "contact_shape.position_sd_sharp",
    "doubt.share": "model_error.sparse",
    "fiducials.fewest": "fiducials.min_visible",
    "fiducials.picture": "fiducials.center_sd",
    "gauge.telling": "gas_filter.informative",
    "inverse.knock_min": "inverse.displaced_min",
    "inverse.knock_rotation": "inverse.displaced_rotation",
    "inverse.knock_shift": "inverse.displaced_shift",
    "slip.body_speed": "slip.shape_speed",
    "slip.body_spin": "slip.shape_spin",
    "slip.body_sure": "slip.shape_sure",
    # sections, with all other settings
    "body": "contact_shape",
    "consensus": "neighbor_smoothing",
    "doubt": "model_error",
    "gauge": "gas_filter",
    "preference": "pose_disambiguation",
    "thorough": "exhaustive_detection",
}
"""Setting of the sensing pipeline, or section of settings, before 0.2.0 to the one now."""

OPTIONS: Mapping[str, str] = {
    "--vary": "--randomization",
    "--shapes": "--contact-shapes",
    "--slow": "--time-scale",
    "--specimen": "--as-built",
    "--like": "--template",
    "--known": "--fix",
    "--feel-mN": "--detect-force-mN",
    "--on": "--setup",
    "--from": "--input",
    "--at": "--position-mm",
    "--touch-mm": "--first-contact-sd-mm",
    "--steps": "--protocol",
    "--against": "--suite",
    "bench --against": "--baseline",
    "--screen": "--screening-sample",
    "--cause": "--parameter",
    "--until-s": "--end-s",
    "--begin": "--start",
    "--fast": "--no-realtime",
    "--turn-deg": "--rotation-deg",
    "shadow": "compare-sim",
    "locate": "detect-circles",
    "make": "fabricate",
    # benchmarks
    "levels": "meshless",
    "bars": "uncertainty",
    "cheap": "no-images",
    "drawn": "error-model",
    "--level drawn": "--level synthetic",
    "--level film": "--level quasistatic",
    "truth": "references",
    "thin": "thin-objects",
    "trust": "camera-faults",
    "attacks": "fault-injection",
    "settings": "setting-sensitivity",
    "gauge": "gas-filter-sensitivity",
    "seen": "detection-sensitivity",
    "bodies": "shape-sensitivity",
    "first_day": "commissioning",
    "numbers": "benchmark-index",
    "summary-page": "benchmark-index",
    "headline": "readme-table",
    "film": "quasistatic",
}
"""Option, command or benchmark before 0.2.0 to the one now."""

EFFECTS: Mapping[str, str] = {"sheet": "mesh", "chain": "pipeline"}
"""Name of an effect before 0.2.0 to name now."""

COLUMNS: Mapping[str, str] = {"pressure_gauge": "gauge_pressure", "varied": "randomized"}
"""Column of a recording before 0.2.0 to column now."""

TEXTS: Mapping[str, Mapping[str, str]] = {
    "status": (
        codes := {
            "no answer": "perception timeout",
            "no shape": "fit failed",
            "air moves": "pressure changing",
            "too weak": "force too low",
            "too little seen": "incomplete data",
            "undecided": "ambiguous",
        }
    ),
    "status_code": codes,
    "shape_kind": {"face": "flat", "tip": "point", "several": "multiple"},
}
"""Column of a recording to its texts before 0.2.0 and those now."""


FLAGS: Mapping[str, str] = {
    "edge": "sharp_edge",
    "feature": "small_feature",
    "frame": "frame_contact",
    "rim": "rim_contact",
    "beyond": "unsensed_force",
    "film": "quasistatic",
}
"""Kind of a flag before 0.2.0 to kind now."""


def hint(name: str, renamed: Mapping[str, str] = KEYS) -> str:
    """Return ": `name` is now ..." for an old name, and an empty text for any other."""
    return f": `{name}` is now `{renamed[name]}`" if name in renamed else ""


def setting_hint(path: str) -> str:
    """Return ": `path` is now ..." for the old name of a setting, else an empty text."""
    section, dot, name = path.partition(".")
    new = SETTINGS.get(path) or (f"{SETTINGS[section]}{dot}{name}" if section in SETTINGS else "")
    return f": `{path}` is now `{new}`" if new else ""


def explain_option(message: str, command: str) -> str:
    """Return the parser's error, with the new name of an old option, command or benchmark in place
    of the list of choices. An option may have another new name in `command`."""
    problem = message.partition(" (choose")[0]
    if not re.search("invalid choice|unrecognized|ambiguous", problem):  # its words are no names
        return message
    for word in re.findall(r"(?<![\w-])-{0,2}[a-z][\w-]*", problem):
        if new := OPTIONS.get(f"{command} {word}", OPTIONS.get(word)):
            return f"{problem}: `{word}` is now `{new}`"
    return message


def old_key(key: str) -> str:
    """Return the name that a file key had before 0.2.0.

    Seeds of random streams are hashes of it, so that a seed yields the same samples as before.
    """
    return next((old for old, new in KEYS.items() if new == key), key)


def old_keys(table: Mapping[str, Any]) -> dict[str, Any]:
    """Return a nested table with the earlier names and values, for fingerprints of older files."""
    return {
        old_key(key): old_keys(value) if isinstance(value, Mapping) else _old_value(key, value)
        for key, value in table.items()
    }


def _old_value(key: str, value: Any) -> Any:
    return next((old for old, new in VALUES.get(key, {}).items() if new == value), value)


def current_row(row: dict[str, Any]) -> dict[str, Any]:
    """Translate the columns of one line of a recording's log, and the keys of its scenario."""
    row = {COLUMNS.get(key, key): value for key, value in row.items()}
    for key in TEXTS.keys() & row.keys():
        if isinstance(row[key], list):
            row[key] = [_current(TEXTS[key], text) for text in row[key]]
    if isinstance(row.get("scenario"), Mapping):
        row["scenario"] = {KEYS.get(key, key): value for key, value in row["scenario"].items()}
    return row


def _current(texts: Mapping[str, str], text: Any) -> Any:
    return texts.get(text, text) if isinstance(text, str) else text
