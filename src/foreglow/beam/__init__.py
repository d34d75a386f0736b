"""The fifth stage: what our headlamps shall shine, checked, and as messages on the car's bus."""
