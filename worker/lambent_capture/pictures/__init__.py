"""Files of pictures: levels as stored, colour spaces, alpha, masks, lenses."""
