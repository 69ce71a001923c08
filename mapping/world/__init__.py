"""A map without bounds: tiles on disk, from which a scrolling window borrows its cells."""
