"""What is sound of a damaged recording."""
