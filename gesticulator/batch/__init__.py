"""Many recordings: jobs, long recordings in pieces, shards, Ray, manifests."""
