"""What `foreglow demo` says about a drive: when light was visible, detected and confirmed, and the car in sight."""
