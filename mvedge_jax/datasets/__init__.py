"""Light fields in: benchmark and camera formats, and rendered scenes."""
