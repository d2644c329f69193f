"""One supervised worker process per job, and what both sides need: a channel, output folders."""
