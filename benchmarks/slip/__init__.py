"""Random cases of slip and hold: true slips and detections."""
