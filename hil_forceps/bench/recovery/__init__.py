"""A damaged recording made whole as far as its file and its bus log allow."""
