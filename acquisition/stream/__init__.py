"""The MCAP stream: one writer, one reader, parts of a recording."""
