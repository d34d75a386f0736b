"""What makes and measures the system, and is never needed in the car: simulation, learning, evaluation, studies."""
