"""One file a relic, `make(folder, rng)`; `solids` and `drawing` serve them all."""
