"""Scene to voxels to convex cover, and the certificate of coverage."""
