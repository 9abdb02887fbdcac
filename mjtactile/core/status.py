"""Validity of a value: a code for programs, and a sentence for users."""

from __future__ import annotations

from enum import StrEnum


class StatusCode(StrEnum):
    """Cause of an invalid value. The first stage that detects a fault sets it. Later stages pass it
    on."""

    OK = "ok"
    NO_IMAGE = "no image"  # the camera is blind, late or stale
    # the process that evaluates the images does not answer, or failed
    PERCEPTION_TIMEOUT = "perception timeout"
    TOO_FEW_MARKERS = "too few markers"
    FIT_FAILED = "fit failed"  # the markers fit no shape that the membrane can have
    OVERLOADED = "overloaded"  # the previous force was large, and no shape has fitted since
    # the rest reference is no longer valid: temperature change or camera motion
    REFERENCE_LOST = "reference lost"
    PRESSURE_CHANGING = (
        "pressure changing"  # the chamber's pressure changes too fast to be followed
    )
    INCONSISTENT = "inconsistent"  # the pressure sensor contradicts the estimated shape
    FORCE_TOO_LOW = "force too low"  # the force is too small for an estimate
    INCOMPLETE_DATA = "incomplete data"  # the probe was not finished
    AMBIGUOUS = "ambiguous"  # the evidence fits two answers
    NOT_ESTIMATED = "not estimated"  # not provided by this method
    OTHER = "other"  # a text without a code: an older recording, a user's own


class Status(str):
    """Status of a value: `"ok"`, or a short reason why it is not reliable.

    `code` is the same for programs. The status is text, so that `status == "ok"` and arrays need no
    conversion. Recordings hold the text. A message may contain values. "unknown" is a valid result;
    zero is not.
    """

    __slots__ = ("code",)
    code: StatusCode

    def __new__(cls, code: StatusCode, message: str = "") -> Status:
        self = super().__new__(cls, message or code.value)
        self.code = code
        return self

    @classmethod
    def of(cls, text: str) -> Status:
        """Return `text` if it is already a status; otherwise convert it.

        The new status has code "ok" or OTHER, according to the text.
        """
        if isinstance(text, cls):
            return text
        return cls(StatusCode.OK if text == StatusCode.OK else StatusCode.OTHER, text)

    def __reduce__(self) -> tuple[type[Status], tuple[StatusCode, str]]:
        return Status, (self.code, str(self))


OK = Status(StatusCode.OK)
