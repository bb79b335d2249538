"""From a depth image to planar regions that a foot may step on (QuadPiPS, sections IV and V)."""

#: What a label image's values mean; an unknown place is never stepped on.
LABELS = ("unknown", "steppable", "passable", "non_passable")
UNKNOWN, STEPPABLE, PASSABLE, NON_PASSABLE = range(4)
