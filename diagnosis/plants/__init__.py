"""Machines that can be diagnosed: what each is made of, one small file each."""
