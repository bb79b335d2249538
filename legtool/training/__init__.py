"""The fits, and the export of a frozen bundle."""
