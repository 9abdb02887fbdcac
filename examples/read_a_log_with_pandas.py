"""Log of a run in pandas: estimated force in each phase of a grasp.

`mjtactile grasp --frames none --out runs/egg` writes one. Every column with its unit:
docs/reference/recording_format.md.
"""

import sys

import numpy as np
import pandas as pd

rows = pd.read_json(
    sys.argv[1] if len(sys.argv) > 1 else "runs/egg/recording/log.jsonl", lines=True
)
cycles = rows[rows.kind == "cycle"].set_index("time")
forces = cycles.groupby("phase", sort=False).force_normal.agg(
    lambda force: np.round(np.mean(force.tolist(), axis=0), 3)
)
print(forces)
