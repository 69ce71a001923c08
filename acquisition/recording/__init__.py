"""The recorder: a thread for each source, bounded queues, outputs that may fail."""
