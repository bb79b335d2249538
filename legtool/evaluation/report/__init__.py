"""Numbers with their intervals, and the pages that show them."""
