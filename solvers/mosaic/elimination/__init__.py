"""Points on the plane eliminated from a block of photos (compiled)."""
