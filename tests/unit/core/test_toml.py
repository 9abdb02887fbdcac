"""Tests of TOML files: any file is read or refused in one line; a field is read exactly or
named."""

import math
import re

import pytest

from mjtactile.core.errors import InputError
from mjtactile.core.toml import LARGEST, Section, parse_toml, read_json, read_toml


def test_a_byte_order_mark_is_not_part_of_the_file(tmp_path):
    (tmp_path / "x.toml").write_bytes(b"\xef\xbb\xbf[bus]\nport = 'a'\n")
    assert read_toml(tmp_path / "x.toml") == {"bus": {"port": "a"}}
    (tmp_path / "x.json").write_bytes(b'\xef\xbb\xbf{"a": 1}')
    assert read_json(tmp_path / "x.json") == {"a": 1}


@pytest.mark.parametrize(
    "content",
    [b"\xff\xfe[", b"a = ", b"a = " + b"[" * 100_000, b"a = " + b"9" * 5000, b"\0"],
    ids=["bytes", "half", "deep", "digits", "zero"],
)
@pytest.mark.parametrize(("read", "kind"), [(read_toml, "TOML"), (read_json, "JSON")])
def test_another_kind_of_file_is_refused_in_one_line(tmp_path, content, read, kind):
    path = tmp_path / "x"
    path.write_bytes(content)
    with pytest.raises(InputError, match=f"^{re.escape(str(path))}: not valid {kind}") as caught:
        read(path)
    assert "\n" not in str(caught.value)


def test_unreadable_and_too_large_files_are_refused(tmp_path):
    with pytest.raises(InputError, match="cannot be read: Is a directory"):
        read_toml(tmp_path)
    with pytest.raises(InputError, match="cannot be read: No such file"):
        read_json(tmp_path / "none.json")
    with (tmp_path / "large.toml").open("wb") as file:
        file.truncate(LARGEST + 1)
    with pytest.raises(InputError, match="larger than 8 MiB"):
        read_toml(tmp_path / "large.toml")


@pytest.mark.parametrize("value", [math.nan, math.inf, -1, 10**400, True, "1", [1]])
def test_a_number_is_within_its_range_or_named(value):
    with pytest.raises(InputError, match=r"^f: bus\.rate_Hz: "):
        Section({"rate_Hz": value}, "bus", "f").number("rate_Hz", 0, 100)


def test_a_missing_field_lists_the_present_fields():
    section = Section({"rate_kHz": 1, "portt": "a"}, "bus", "f")
    with pytest.raises(InputError, match="rate_Hz: missing field; there is 'rate_kHz': wrong unit"):
        section.number("rate_Hz", 0, 1)
    with pytest.raises(InputError, match="port: missing field; there is 'portt': wrong name"):
        section.text("port")


def test_null_is_read_as_a_missing_field():
    with pytest.raises(InputError, match="missing field"):
        Section({"a": None}, "", "f").number("a", 0, 1)
    assert Section({"a": None}, "", "f").number("a", 0, 1, default=7) == 7


@pytest.mark.parametrize("text", ["a = 0x" + "f" * 6000, "a = -0b" + "1" * 9000])
def test_a_number_of_thousands_of_digits_is_refused(text):
    """Python cannot print it, so that no message could name it."""
    with pytest.raises(InputError, match="more than 99 digits"):
        parse_toml(text, "a.toml")


def test_a_message_about_a_long_value_is_short():
    error = InputError(f"{'x' * 100_000!r} is unknown", source="a.toml", choices=["y"])
    assert len(str(error)) < 1500
    assert str(error).startswith("a.toml: 'xxx") and str(error).endswith("is unknown (valid: y)")
