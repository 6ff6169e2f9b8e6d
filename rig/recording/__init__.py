"""The run folder: written row by row by a process of its own, read back as arrays.

recorder   the loop's side: memory writes only
writer     the process that puts the rows on disk
layout     the memory the two share
columns    the columns of samples.csv and their text
folder     the run folder and its small files
path_kind  what a path is that is no recording, and what to type instead
reader     run folders and plain CSV files as arrays

Nothing is imported here but the error, so that the writer process starts fast.
"""

from rig.recording.errors import RecordingError

__all__ = ["RecordingError"]
