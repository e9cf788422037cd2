"""The one exception for a user's mistake, told in one line."""


class Problem(Exception):
    """Names the file, the thing, what was expected and what was found. No traceback is shown."""
