"""Experiments, each in a folder of its own."""

STUDIES = {
    "simulator": "foreglow.lab.studies.simulator.command",
    "distance": "foreglow.lab.studies.distance.command",
    "detector": "foreglow.lab.studies.detector.command",
    "time-benefit": "foreglow.lab.studies.time_benefit.command",
    "runtime": "foreglow.lab.studies.runtime.command",
    "glare": "foreglow.lab.studies.glare.command",
    "occurrence": "foreglow.lab.studies.occurrence.command",
    "detection-range": "foreglow.lab.studies.detection_range.command",
}
"""What `foreglow experiment` offers: for each name the module whose function `command` runs the experiment.

These modules import light modules only, so that the help of the program is there at once.
"""
