"""Thin things pressed into a membrane at random places and speeds: is the force the same?"""
