"""A small network for masks, trained on drawings alone: layers are drawn, composed at random, and learned from."""
