"""The emulator's Protocol 2.0, against packets printed in ROBOTIS's manual
(emanual.robotis.com/docs/en/dxl/protocol2)."""

import random

import pytest

from mjtactile.emulator import protocol2 as p2

PRINTED = {
    "ping": "FF FF FD 00 01 03 00 01 19 4E",
    "ping's status": "FF FF FD 00 01 07 00 55 00 06 04 26 65 5D",
    "broadcast ping": "FF FF FD 00 FE 03 00 01 31 42",
    "read": "FF FF FD 00 01 07 00 02 84 00 04 00 1D 15",
    "read's status": "FF FF FD 00 01 08 00 55 00 A6 00 00 00 8C C0",
    "write": "FF FF FD 00 01 09 00 03 74 00 00 02 00 00 CA 89",
    "write's status": "FF FF FD 00 01 04 00 55 00 A1 0C",
    "factory reset": "FF FF FD 00 01 04 00 06 01 A1 E6",
    "reboot": "FF FF FD 00 01 03 00 08 2F 4E",
    "sync read": "FF FF FD 00 FE 09 00 82 84 00 04 00 01 02 CE FA",
    "sync read's second status": "FF FF FD 00 02 08 00 55 00 1F 08 00 00 BA BE",
    "sync write": "FF FF FD 00 FE 11 00 83 74 00 04 00 01 96 00 00 00 02 AA 00 00 00 82 87",
}


@pytest.mark.parametrize("name", PRINTED)
def test_crc_equals_the_published_value(name):
    packet = bytes.fromhex(PRINTED[name])
    assert p2.crc16(packet[:-2]) == int.from_bytes(packet[-2:], "little")
    assert p2.fast_crc16(packet[:-2]) == p2.crc16(packet[:-2])


@pytest.mark.parametrize("name", PRINTED)
def test_encoding_gives_the_published_bytes(name):
    packet = bytes.fromhex(PRINTED[name])
    assert p2.encode(packet[4], packet[7], packet[8:-2]) == packet


def test_decoding_inverts_encoding_with_stuffing_and_garbage():
    parameters = b"\x74\x00\xff\xff\xfd\xff\xff\xfd\x00"  # two sequences that require stuffing
    packet = p2.encode(1, p2.WRITE, parameters)
    assert packet.count(b"\xff\xff\xfd\xfd") == 2
    found = list(p2.Decoder().feed(b"\xff\xff\x00junk" + packet + b"\xff"))
    assert [(f.servo, f.code, f.parameters, f.intact) for f in found] == [
        (1, p2.WRITE, parameters, True)
    ]


def test_a_wrong_crc_is_detected():
    packet = bytearray(p2.encode(1, p2.PING))
    packet[-1] ^= 1
    assert [f.intact for f in p2.Decoder().feed(bytes(packet))] == [False]


def test_random_bytes_neither_crash_nor_stop_the_decoder():
    rng = random.Random(0)
    decoder = p2.Decoder()
    for _ in range(300):
        noise = bytes(
            rng.choice((0xFF, 0xFD, 0x00, rng.randrange(256))) for _ in range(rng.randrange(200))
        )
        assert all(not f.intact or f.code != p2.WRITE for f in decoder.feed(noise))
    list(decoder.feed(bytes(2000)))  # a packet header in the noise has ended
    assert [f.code for f in decoder.feed(p2.encode(1, p2.PING))] == [p2.PING]
