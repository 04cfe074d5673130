"""Many recordings: jobs, pieces of long ones, shards, Ray, manifests."""
