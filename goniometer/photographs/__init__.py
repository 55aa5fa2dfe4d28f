"""Series of photographs of one sample under light from many angles."""
