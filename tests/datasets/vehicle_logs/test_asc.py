"""Vector's logs in text, of which python-can passes over what it does not know."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from foreglow.datasets.vehicle_logs import read_can_log, write_can_log
from tests.datasets.vehicle_logs.messages import message

pytest.importorskip("can")
pytest.importorskip("cantools")


@pytest.mark.parametrize(
    "line",
    [
        "1x.0 1 3A1 Rx d 8 00 00 00 00 00 00 00 00",
        "nan 1 3A1 Rx d 8 00 00 00 00 00 00 00 00",
        "12 1 3A1 Rx d 8 00 00 00 00 00 00 00 00",
        "1.0 1b 3A1 Rx d 8 00 00 00 00 00 00 00 00",
        "1.0 1 3-1 Rx d 8 00 00 00 00 00 00 00 00",
        "1.0 1 3G1 Rx d 8 00 00 00 00 00 00 00 00",
        "1.0 1 3A1 Rx d 99 00 00 00 00 00 00 00 00",
        "1.0 1 3A1 Rx d -1 00 00 00 00 00 00 00 00",
        "1.0 1 3A1 Rx d 8 00 00 00",
        "1.0 1 3A1 Rx d 8 00 00 070 00 00 00 00 00",
        "1:0 CANFD 1 Rx 3A1 1 0 8 8 00 00 00 00 00 00 00 00 0 0 0 0 0 0 0 0",
        "1.0 CANFD 1 Rx 3A1 1 0 8 99 00 00 00 00 00 00 00 00",
        "1.0 CANFD 1 Rx 3A1 1 0 8 -1 00 00 00 00 00 00 00 00",
    ],
)
def test_a_broken_frame_of_an_asc_is_named(line: str, tmp_path: Path) -> None:
    """Such lines were passed over, or taken with what they had."""
    path = tmp_path / "drive.asc"
    write_can_log(path, [(0, message())])
    lines = path.read_text().splitlines()
    path.write_text("\n".join([*lines[:-1], line, lines[-1]]))
    with pytest.raises(ValueError, match=rf"drive\.asc: line {len(lines)}: expected a frame as a CAN log of the kind"):
        read_can_log(path)


@pytest.mark.parametrize(
    "head",
    [
        "",
        "date Thu Nov 26 10:00:00.000 am 2026\nbase hex timestamps absolute\n",
        "; a recorder of ours\n\ndate Thu Nov 26 10:00:00.000 am 2026\nbase hex timestamps absolute\n",
        "base hex timestamps absolute\nno internal events logged\n",
    ],
)
def test_the_first_frame_of_an_asc_counts_whatever_its_head_is(tmp_path: Path, head: str) -> None:
    whole, path = tmp_path / "whole.asc", tmp_path / "drive.asc"
    write_can_log(whole, [(0, message())])
    frames = [line for line in whole.read_text().splitlines() if re.match(r"\s*\d+\.\d+\s+\d+\s+\w+\s+[RT]x", line)]
    path.write_text(head + "\n".join(frames) + "\n")
    assert read_can_log(path).has_street


@pytest.mark.parametrize(
    "line",
    ["base oct", "base oct timestamps absolute", "base hex timestamps rel", "base hex absolute", "base ", "BASE bin"],
)
def test_a_base_that_is_not_known_is_refused(tmp_path: Path, line: str) -> None:
    """It was read as hexadecimal and absolute."""
    path = tmp_path / "drive.asc"
    write_can_log(path, [(0, message())])
    path.write_text(re.sub("base hex.*", line, path.read_text()))
    with pytest.raises(
        ValueError, match=r"drive\.asc: line 2: expected base hex or dec, timestamps absolute, got '[bB]"
    ):
        read_can_log(path)


@pytest.mark.parametrize("line", ["base hex", "  Base hex  timestamps  Absolute  "])
def test_a_base_that_is_known_is_read(tmp_path: Path, line: str) -> None:
    path = tmp_path / "drive.asc"
    write_can_log(path, [(0, message())])
    path.write_text(re.sub("base hex.*", line, path.read_text()))
    assert read_can_log(path).has_street


EVENTS = """
// 1.0 1 3A1 Rx d 8 00
//1.0 1 3A1 Rx d 8 00
   0.000000 Start of measurement
   0.010000 1  Statistic: D 0 R 0 XD 0 XR 0 E 0 O 0 B 0.00%
   0.010000 CAN 1 Status:chip status error active
   0.010000 1  ErrorFrame
   0.010000 CANFD   1 Rx ErrorFrame  Not Acknowledge error, dominant error flag  fffe c7 31ca Rx 0 0 f 0 0 0 0 0
   0.010000 1  OverloadFrame
   0.010000 1  J1939TP FEE3p 6 0 0 - Rx d 23 A0 0F A6 60 3B D1 40 1F DE 80 3E BB 00 00 00 00 00 00 00 00 00 00 00
   0.010000 1  7FE Tx r
   0.010000 1  7FE Rx d 0 Length = 0 BitCount = 4
   0.010000 1  7FE Tx d F 00 00 00 00 00 00 00 00
   0.010000 1  18EBFF00x Rx d 8 01 A0 0F A6 60 3B D1 40  Length = 273910 BitCount = 141 ID = 418119424x
   0.010000 CANFD   1 Rx 7FE  Name_of_It 1 0 9 12 00 00 00 00 00 00 00 00 00 00 00 00 0 0 0 0 0 0 0 0
   0.010000 L1 3C Rx 8 00 00 00 00 00 00 00 00 checksum = ff
   0.010000 SV: 3 0 1 ::Variable = 1
   0.010000 log trigger event
  -0.010000 1  7FE Rx d 1 00
Something that a program has noted
""".strip("\n")


def test_events_that_are_no_frames_are_left_out(tmp_path: Path) -> None:
    path = tmp_path / "drive.asc"
    write_can_log(path, [(0, message())])
    lines = path.read_text().splitlines()
    path.write_text("\n".join([*lines[:-1], EVENTS, lines[-1]]))
    assert read_can_log(path).street(0) is not None
