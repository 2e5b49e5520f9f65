"""Messages between the image service and those who ask it: addresses, framing on a stream, packing of values.

Nothing here knows what the messages say. A message is one packed map (:mod:`horizonval.wire.packing`) behind a header
of eight bytes (:mod:`horizonval.wire.framing`), on a Unix socket or TCP (:mod:`horizonval.wire.address`).
"""

SCHEMA = "horizonval/1"
"""Of what the messages say; every message carries it. Another number is another meaning of the same keys."""
