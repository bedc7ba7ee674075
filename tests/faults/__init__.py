"""Faults at every write of a stage: the process is killed, or the disk fails; the next run ends with the same bytes."""
