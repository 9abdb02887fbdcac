"""MCAP files with Foxglove's schemas (protobuf): an episode a file."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from mjtactile.export import messages
from mjtactile.export.episode import RecordedEpisode, write_each
from mjtactile.export.foxglove_layout import layout
from mjtactile.export.foxglove_sink import FoxgloveFile
from mjtactile.export.viewer_entities import rendered_items
from mjtactile.recording.files import write_json


def write(
    episodes: Sequence[RecordedEpisode],
    out: Path,
    *,
    notify: Callable[[str], None] = lambda _: None,
    leave_out: Callable[[str], None] = lambda _: None,
) -> dict[str, Any]:
    """Write `episode_000000.mcap` and so on into `out`; returns the number of frames."""
    write_json(out / "layout.json", layout(episodes[0].fingers))
    return write_each(episodes, out, ".mcap", _write_one, notify=notify, leave_out=leave_out)


def _write_one(path: Path, episode: RecordedEpisode) -> None:
    sink = FoxgloveFile(path)
    try:
        for item in rendered_items(episode):
            sink.log(item)
        _attach(episode, sink.writer)
    finally:
        sink.close()


def _attach(episode: RecordedEpisode, writer: Any) -> None:
    """Attach the recording's facts, files and reference images."""
    start = messages.nanoseconds(float(episode.recording.columns["time"][0]))
    times = {"log_time": start, "create_time": start}
    facts = {
        key: value if isinstance(value, str) else json.dumps(value)
        for key, value in episode.facts.items()
    }
    writer.write_metadata("mjtactile", facts)
    for name, text in episode.files.items():
        kind = "application/json" if name.endswith(".json") else "application/toml"
        writer.attach(**times, name=name, data=text.encode(), media_type=kind)
    for name, image in episode.references.items():
        writer.attach(**times, name=name, media_type="image/png", data=image.read_bytes())
