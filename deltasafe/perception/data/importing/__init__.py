"""Labels of other tools, converted to a set of images and masks."""
