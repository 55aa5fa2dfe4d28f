"""Height maps of rough surfaces, synthesised and from microscopes."""
