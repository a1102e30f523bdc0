"""Progress of a long search, on terminals only."""

import contextlib


@contextlib.contextmanager
def progress_bar(wanted):
    """Yield a function (round, text) that shows where the search is."""
    if not wanted:
        yield lambda number, text: None
        return
    from tqdm import tqdm

    # disable=None: nothing is written unless stderr is a terminal.
    with tqdm(
        bar_format="{desc} [{elapsed}]", disable=None, leave=False, dynamic_ncols=True
    ) as bar:

        def show(number, text):
            bar.set_description_str(f"{number} effects: {text}")

        yield show
