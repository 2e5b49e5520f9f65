"""Published systems as small experiments: what a source prints, our measurement of each figure, and the judgement.

A system is a folder named by its letter, with two files.

``published.toml``, one entry for each published figure (:class:`horizonval.systems.entries.Entry`)::

    title = "Static infrared horizon sensor with four linear heads"
    source = "authors, title, year"
    summary = "Markdown; {rms:.3f} is the measured value of the entry `rms`, {tilt[2]:.1f} the third one of a list."
    choices = ["What was chosen after a result was seen."]

    [given]                  # printed conditions of the experiment, any keys: experiment.py uses them
    altitude_km = 400.0

    [entry.rms]
    what = "error of the model, root mean square"
    printed = 0.038          # a number; a list of numbers; a statement as text; without it the figure is ours alone
    unit = "deg"
    where = "section 4"      # in the source
    reading = "How we read the figure, and how we measure it."
    at_most = 0.038          # what makes it fail, see below
    fails = "More words on what makes it fail."
    good = "bounded"         # the status if it does not fail; "reproduced" by default
    labels = ["roll", "pitch"]       # for a list: what each number belongs to

    [figure]
    errors = "Caption of the picture `errors`. Its first sentence is the picture's text."

A measured value fails above ``at_most``, below ``at_least``, farther than ``within`` from the printed figure, or beyond
the ``factor`` of it; for a list each may be a list. An entry without any of them cannot be judged: its status is "not
determinable" if it is printed, and empty if it is ours. Only such an entry may go unmeasured.

``experiment.py``, on the public API, two functions of a :class:`horizonval.systems.task_cache.TaskCache`::

    def reproduce(cache: TaskCache) -> Result: ...   # everything
    def quick(cache: TaskCache) -> Values: ...       # key figures in seconds, for the nightly

``Values`` maps entries to their measured values, a number or a sequence of numbers. ``Result`` adds pictures, extra
tables, and notes, which are shown with the measured value. :mod:`horizonval.systems.page` makes ``<X>.json``,
``<X>.md`` and ``<X>-<picture>.png`` of them, and the first page over all systems.
"""
