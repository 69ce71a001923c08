"""Maps as files, pictures and reports."""
