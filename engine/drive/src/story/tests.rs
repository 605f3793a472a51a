//! Stories on a straight road: motion against closed forms.
