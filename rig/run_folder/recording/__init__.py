"""The run folder: a process of its own writes it row by row; the reader gives it back as arrays.

sink       what takes rows and events
recorder   the sink of a run: it writes to memory only
writer     the process that puts the rows on disk
layout     the memory that recorder and writer share
sample_columns  the columns of samples.csv and their text
folder     the run folder and its small files
follow     live progress of a run
recording  ``Recording``: the rows of a run folder or a CSV file as arrays
reader     reads run folders, CSV files, and what a program gives
curves     the arrays behind a run's answer, written and read
csv_file   reads a CSV file with the columns of samples.csv
csv_table  a CSV file as lines, fields and columns
log_file   reads a CSV file with other columns and units; ``log_format`` says which
text_file  files as text, whatever is in them
series     ``TimeSeries``: the numbers of one stretch of a recording
stage      the stages of a run
path_kind  when a path is not a recording: what it is, and what to type

This file imports the error alone, so that the writer process starts fast.
"""

from rig.run_folder.recording.errors import RecordingError

__all__ = ["RecordingError"]
