"""The one error that a user may see: a line that says what to change, and an exit code."""

DONE, MISSED, USAGE, STOPPED = 0, 1, 2, 75
"""Exit codes: done, target missed, wrong usage or input, stopped and to be continued."""


class UserError(ValueError):
    """Something outside the program is wrong and its user can put it right.

    The message is one line: what, the value found, what is allowed, what to do.
    """

    def __init__(self, message: str, exit_code: int = USAGE):
        super().__init__(message)
        self.exit_code = exit_code
