"""From fifty labelled images to a robot that moves safely close to a human hand."""
