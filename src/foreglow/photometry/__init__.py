"""Lamps as lighting engineers describe them: intensity tables, the illuminance that follows, and tables that ship."""

from foreglow.photometry.ies import read_ies
from foreglow.photometry.intensity import IntensityTable, illuminance_lx
from foreglow.photometry.lamps import high_beam, low_beam, position_lamp, rear_lamp, street_lamp, window
from foreglow.photometry.matrix import NUM_LEDS, MatrixLamp, matrix_beam

__all__ = [
    "NUM_LEDS",
    "IntensityTable",
    "MatrixLamp",
    "high_beam",
    "illuminance_lx",
    "low_beam",
    "matrix_beam",
    "position_lamp",
    "read_ies",
    "rear_lamp",
    "street_lamp",
    "window",
]
