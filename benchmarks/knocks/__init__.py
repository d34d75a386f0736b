"""A campaign of hard knocks: hostile input for every reader and command, and what must hold whatever comes.

`python -m benchmarks.knocks` runs every probe in a process of its own with bounded memory and time. `probe.py` says
what must hold, `materials.py` makes the sound files, `mutations.py` damages them, `campaign.py` lists the probes.
"""
