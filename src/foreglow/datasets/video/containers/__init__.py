"""Containers, looked through for damage and missing ends, of which FFmpeg says nothing: a module for each kind.

`ends` chooses the kind; `transport` counts the packets of MPEG-TS while they are read.
"""
