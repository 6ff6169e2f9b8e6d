"""Errors of the stand-in."""


class Error(Exception):
    pass


class DaqNotFoundError(Error):
    pass


class DaqNotSupportedError(Error):
    pass


class DaqError(Error):
    def __init__(self, message: str, error_code: int, task_name: str = "") -> None:
        self.error_code = error_code
        super().__init__(f"{message}\n\nStatus Code: {error_code}")


class DaqWriteError(DaqError):
    def __init__(self, message: str, error_code: int, samps_per_chan_written: int, task_name: str = "") -> None:
        super().__init__(message, error_code, task_name)
        self.samps_per_chan_written = samps_per_chan_written


class DaqResourceWarning(ResourceWarning):
    pass
