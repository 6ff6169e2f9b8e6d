"""The runs of a folder: one line each, from an index beside them that is never trusted over the folder."""
