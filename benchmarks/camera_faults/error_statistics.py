"""Statistics of force errors and of their reported uncertainty."""

from __future__ import annotations

from typing import Any

import numpy as np

from benchmarks.camera_faults.replay import Grasp, ReplayResult

# beyond both is wrong
FAR_SD = 5.0
FAR_N = 0.05


def numbers(grasp: Grasp, estimated: ReplayResult) -> dict[str, Any]:
    """Compute force errors where the status is ok, and count the large ones."""
    touches = estimated.touches
    known = np.array([touch.status == "ok" for touch in touches], bool)
    off = np.array([touch.force_normal for touch in touches]) - grasp.true[: len(touches)]
    sd = np.array([touch.force_normal_sd for touch in touches])
    off = off[known]
    sd = sd[known]
    far = (np.abs(off) > FAR_SD * sd) & (np.abs(off) > FAR_N)
    reported = [str(touch.status.code) for touch in touches]
    count = [0 if touch.markers is None else len(touch.markers) for touch in touches]
    return {
        "images": len(grasp.images),
        "ok": int(known.sum()),
        "far": int(far.sum()),
        "rms_N": float(np.sqrt((off**2).mean())) if len(off) else None,
        "worst_N": float(np.abs(off).max()) if len(off) else None,
        "sd_N": float(np.median(sd)) if len(sd) else None,
        "status": {code: reported.count(code) for code in sorted(set(reported))},
        "markers": float(np.median(count)) if count else None,
        "refused": estimated.refused,
    }
