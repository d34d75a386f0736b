"""What a car knew during a drive, read from files beside its images: CAN logs, maps with poses, and a calibration."""

from foreglow.datasets.vehicle_logs.can_log import CanDecoder, CanLog, read_can_log
from foreglow.datasets.vehicle_logs.can_writing import write_can_log
from foreglow.datasets.vehicle_logs.vehicle_files import VehicleFiles, open_vehicle_data

__all__ = ["CanDecoder", "CanLog", "VehicleFiles", "open_vehicle_data", "read_can_log", "write_can_log"]
