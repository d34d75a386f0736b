"""Lamps as lighting engineers describe them: tables of intensity, the illuminance that follows, and built-in lamps."""

from foreglow.photometry.headlamps import Headlamp, Headlamps
from foreglow.photometry.headlamps_file import matrix_beam, read_headlamps, read_lamp_file
from foreglow.photometry.ies import read_ies
from foreglow.photometry.intensity import IntensityTable, illuminance_lx
from foreglow.photometry.lamps import (
    bicycle_lamp,
    brake_lamp,
    centre_brake_lamp,
    high_beam,
    low_beam,
    marker_lamp,
    position_lamp,
    rear_lamp,
    street_lamp,
    traffic_light,
    window,
)
from foreglow.photometry.ldt import read_ldt
from foreglow.photometry.matrix import NUM_LEDS, MatrixLamp

__all__ = [
    "NUM_LEDS",
    "Headlamp",
    "Headlamps",
    "IntensityTable",
    "MatrixLamp",
    "bicycle_lamp",
    "brake_lamp",
    "centre_brake_lamp",
    "high_beam",
    "illuminance_lx",
    "low_beam",
    "marker_lamp",
    "matrix_beam",
    "position_lamp",
    "read_headlamps",
    "read_ies",
    "read_lamp_file",
    "read_ldt",
    "rear_lamp",
    "street_lamp",
    "traffic_light",
    "window",
]
