"""The base class of the errors that a user of the benchmark can cause."""


class GGBenchError(Exception):
    """An error a user can cause.

    Its message is a sentence that says what was wrong, where, and what is allowed.
    """
