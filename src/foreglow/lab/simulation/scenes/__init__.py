"""What a drive is: the scenario language, and the scenarios that draw it."""
