"""Slips and holds by the hundred: random cases, what really slid, what was detected."""
