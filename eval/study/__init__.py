"""A user study: the page for raters, and what their answers say."""
