"""Files that Rerun's viewer opens: an episode a file."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from mjtactile.export.episode import RecordedEpisode, write_each
from mjtactile.export.rerun_sink import RerunSink, to_file
from mjtactile.export.viewer_entities import rendered_items


def write(
    episodes: Sequence[RecordedEpisode],
    out: Path,
    *,
    notify: Callable[[str], None] = lambda _: None,
    leave_out: Callable[[str], None] = lambda _: None,
) -> dict[str, Any]:
    """Write `episode_000000.rrd` and so on into `out`; returns the number of frames."""

    def write_one(path: Path, episode: RecordedEpisode) -> None:
        sink = RerunSink(episode.fingers)
        to_file(sink, path)
        for item in rendered_items(episode):
            sink.log(item)
        sink.close()

    return write_each(episodes, out, ".rrd", write_one, notify=notify, leave_out=leave_out)
