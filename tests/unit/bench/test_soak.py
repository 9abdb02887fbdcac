"""Tests of the long run: a real leg on the emulated rig, and its table."""

import pytest

from benchmarks.rig import soak
from benchmarks.rig.faults import FAULTS

LEG = {
    "fault": "puncture",
    "seconds": 300.0,
    "cycles": 18000,
    "missed": 9,
    "not_running": 0,
    "grips": 15,
    "injected": True,
    "safe": True,
    "reaction_s": 0.05,
    "outcome": "leak",
    "recording": "",
    "process": 7,
    "memory_MB": 100.0,
}


@pytest.mark.slow(40)
@pytest.mark.clock
def test_a_soak_section_injects_a_fault_and_reads_its_recording(tmp_path):
    bench = soak.SoakBench(tmp_path, leg=10.0, grip=6.0)
    try:
        found = bench.run(0)
    finally:
        bench.end()
    assert found["injected"] and found["safe"] and found["reaction_s"] < 0.2, (
        found
    )  # required: 200 ms
    assert 4.0 < found["seconds"] < 10.1 and found["grips"] >= 1 and found["recording"] == ""
    assert list(tmp_path.iterdir()) == []  # only failed runs are kept


def test_every_kind_of_fault_occurs_before_any_repeats(tmp_path):
    sampled = [soak.sampled(number, soak.LEG, soak.GRIP) for number in range(2 * len(FAULTS))]
    kinds = [kind for kind, _ in sampled]
    assert (
        set(kinds[: len(FAULTS)]) == set(kinds[len(FAULTS) :]) == set(FAULTS)
        and kinds[:16] != kinds[16:]
    )
    assert all(soak.LEG - soak.GRIP <= at <= soak.LEG for _, at in sampled) and len(
        {at for _, at in sampled}
    ) == len(sampled)


def test_the_table_lists_the_failures():
    late = LEG | {"reaction_s": 0.3, "missed": 171, "memory_MB": 101.5}
    early = LEG | {
        "injected": False,
        "safe": False,
        "reaction_s": None,
        "outcome": "left camera is stale",
        "recording": "torn",
    }
    reported = {label: value for label, _, value in soak.soak_rows([LEG, LEG, late, early])}
    longer = [LEG | {"memory_MB": 100.0 + count} for count in range(1, 9)]
    assert reported["long run of 0.33 h, 60 grips of an egg: missed cycles"] == "0.28 % of 72000"
    assert reported["long run: safe state after a fault at a random time"] == (
        "3 of 3, 1 later than 200 ms, worst 300 ms"
    )
    assert reported["long run: stops without a fault"] == "1 of 4 legs; left camera is stale"
    assert reported["long run: memory"] == "100.0 MB after 2 legs, 100.0 MB after 4 legs"
    assert soak.growth(longer) == (
        "102.0 MB after 2 legs, 104.0 MB after 4 legs, 108.0 MB after 8 legs"
    )
    assert reported["long run: unreadable recordings"] == "1 of 4"
