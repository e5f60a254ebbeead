"""The pictures of the documents, drawn from numbers that Kennfeld computes here."""
