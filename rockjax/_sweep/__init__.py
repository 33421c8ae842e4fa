"""Very many scenes: in chunks, kept in a store, resumed, on one machine or a cluster."""
