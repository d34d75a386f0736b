"""What `foreglow demo` tells of a drive: when light was visible, detected, confirmed, and the car in sight."""
