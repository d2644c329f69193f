"""Results kept from run to run, by the digest of what decides them."""
