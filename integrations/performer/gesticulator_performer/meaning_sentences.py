"""Sentences whose words call for a gesture with a meaning, by the label of the gesture.

The form is that of `grammar`: slots in braces, `|` ends a phrase, and a line that starts with "=" is held out for test.
"""

MEANING_SENTENCES = """
point_self
 as for me, | I never touched the {thing}.
 personally, | I would {do} the {adj} {thing}.
 the {person} asked me about it, | me of all people.
 = in my case | the {thing} was far too {adj}.
 = I built this {thing} myself, | with my own hands.
point_you
 and you, | have you seen the {thing}?
 it depends on you | whether the {thing} stays {adj}.
 you guys know the {thing} | better than the {person}.
 = what about you, | would you {do} the {thing}?
 = your {thing} stands beside your {other}.
we_all
 all of us | wanted to see the {thing}.
 together with the {person} | we keep the {thing} {adj}.
 everyone here knows | that the {thing} is {adj}.
 = our team found the {thing} in the {place}.
 = together we can {do} any {thing}.
point_here
 right here stood the {thing} of the {person}.
 in this room | the {person} {did} the {thing}.
 it was at this point | that the {thing} became {adj}.
 = on this spot | the {person} found {athing}.
 = keep the {thing} right here, | not in the {place}.
point_there
 far away, | behind the {place}, | waits the {person}.
 over there in the {place} | you will find {athing}.
 that one is more {adj} | than the other {thing}.
 = the {thing} stood far away, | next to the {place}.
 = that one over there | belongs to the {person}.
point_left
 the {thing} hangs on the left, | beside the {other}.
 now turn left | and walk to the {place}.
 on one side | there is only the {thing}.
 = the left-hand side of the {place} is {adj}.
 = push the {thing} to the left.
point_right
 the {thing} hangs on the right, | beside the {other}.
 now turn right | and wait near the {place}.
 the {person} lives to the right of the {place}.
 = the right-hand side of the {place} is {adj}.
 = on the other side | there is only the {thing}.
look_at_this
 look at this {adj} {thing}.
 as you can see, | the {thing} is very {adj}.
 take a look at the {thing} | before the {person} comes.
 = this chart tells you about the {thing}.
 = the {thing} shown here | comes from the {place}.
open_offer
 for instance, | the {person} could {do} the {thing}.
 I suggest | that the {person} keeps the {thing}.
 let me give you {athing} from the {place}.
 here is {athing} | for the {adj} {person}.
 what I mean is | that the {thing} was {adj}.
 = consider the {thing} of the {person}.
 = here is the {thing}, | and here is the {other}.
receive
 the {person} asked for feedback | about the {thing}.
 thank you for the {adj} {thing}.
 give me the {thing}, | please.
 {time} we got {athing} | from the {person}.
 = last year we received {athing} | from the {place}.
 = there was a lot of feedback | on the {adj} {thing}.
palms_question
 why would the {person} {do} the {thing}?
 how come the {thing} is still {adj}?
 what do you think | about the {adj} {thing}?
 the {thing} is gone, | and what now?
 = why is there {athing} in the {place}?
 = what do you think, | is the {thing} {adj}?
shrug
 no idea | where the {person} left the {thing}.
 maybe it was {athing}, | who knows.
 I don't know why the {thing} is {adj}.
 whatever, | the {thing} was {adj} anyway.
 = I can't say | whether the {thing} is {adj}.
 = whatever it was, | the {person} {did} it.
sweep_no
 not at all, | the {thing} is quite {adj}.
 never again | will I {do} {athing}.
 by no means | is the {thing} {adj}.
 none of that | came from the {person}.
 = there is nothing {adj} in the {place}.
 = by no means | was it {athing}.
cut_off
 that's it, | no more {things}.
 it's over, | the {person} has left the {place}.
 the {thing} is done, | finished.
 no more {things} for the {person}, | period.
 = when the {thing} is finished, | the {person} goes home.
 = it's over, | nobody wants the {thing}.
stop_palm
 stop, | this is the wrong {thing}.
 wait, | I forgot the {thing} in the {place}.
 hang on, | which {thing} do you mean?
 not yet, | the {thing} is too {adj}.
 = just a second, | where is the {thing}?
 = not yet, | first comes the {other}.
nod
 that's right, | the {person} {did} the {thing}.
 absolutely, | the {thing} is {adj}.
 I agree, | we need {athing}.
 of course | there is {athing} in the {place}.
 yes, | exactly like the {thing} of the {person}.
 = absolutely, | I saw the {thing} myself.
 = I agree with the {person} about the {thing}.
head_shake
 I disagree, | the {thing} was {adj}.
 unbelievable, | the {person} {did} the {thing} again.
 it isn't the {thing} | that I asked for.
 not the {thing}, | never the {thing}.
 = the price of the {thing} was unbelievable.
 = in that I disagree with the {person}.
wave_hello
 hello, | this is the {person} from the {place}.
 good morning, | I am looking for the {thing}.
 hi everyone, | today we talk about {things}.
 hey, | is that your {thing}?
 = welcome back, | dear friends of the {thing}.
 = hello there, | is anybody in the {place}?
usher
 please come in, | the {person} is waiting.
 have a seat | beside the {thing}.
 this way, | the {thing} is in the {place}.
 after you, | the {place} is narrow.
 welcome to the {place} of the {person}.
 = this way to the {place}, | please.
 = have a seat, | the {person} will come soon.
throw_away
 forget it, | the {thing} is {adj}.
 never mind, | we have another {thing}.
 throw it out, | nobody needs {athing}.
 leave that aside | and look for the {other}.
 who cares | about the {adj} {thing}?
 = forget it, | the {person} took the {thing}.
 = throw it out, | the whole {thing}.
plea
 please, | believe me, | it was {athing}.
 help me with the {thing}, | please.
 try to understand the {person} with the {thing}.
 believe me, | the {thing} was {adj}.
 = please help me | to find the {thing}.
 = try to understand, | there was only one {thing}.
clap
 applause for the {person} | and the {adj} {thing}.
 bravo, | what {athing}.
 congratulations | on the {adj} {thing}.
 give it up for the {person} from the {place}.
 well done everyone, | the {thing} is {adj}.
 = congratulations to the {person} | of the {place}.
 = bravo, bravo, | the {person} {did} the {thing}.
cheer_arms
 hooray, | the {thing} is {adj}.
 finally | we found the {thing} in the {place}.
 we won {athing}, | we really won.
 we did it | without the {person}.
 = finally | there is {athing} for everyone.
 = hooray, hooray, | here comes the {person}.
big_spread
 a massive {thing} | fills the {place}.
 this {thing} is big, | bigger than the {place}.
 the {person} wants an enormous {thing}.
 the {place} is huge, | and the {thing} is large.
 = how wide is the {thing}, | and how large?
 = it was a massive {thing}, | a really big one.
box_frame
 the {thing} came in a package, | a {adj} package.
 that is another topic | for the {person}.
 put the {thing} into a frame.
 the first section | is about the {thing}.
 {things} are a category of their own.
 = the whole box was full of {things}.
 = which category does the {thing} belong to?
surround
 everything in the {place} | was {adj}.
 around the world | people {do} {things}.
 overall | the {thing} was {adj}.
 the entire {place} smelled of {things}.
 = the whole {place} saw the {thing}.
 = overall, | everything turned out {adj}.
empty_hands
 there is nothing left | in the {place}.
 the {place} is empty, | and the {person} has gone.
 we ran out of {things} {time}.
 the {person} has no money | for {athing}.
 = I looked for {things}, | none remaining.
 = no money, | no {thing}, | an empty {place}.
contrast_flip
 on the contrary, | the {thing} was {adj}.
 take the {thing} instead | of the {other}.
 the {person} wanted the {thing}, | but got {athing}.
 actually, | the {thing} was in the {place}.
 however, | nobody {did} the {thing}.
 = instead, | the {person} {did} the {other}.
 = the {thing} was cheap, | actually it was free.
add_beside
 in addition, | there is {athing}.
 furthermore, | the {thing} is {adj}.
 besides, | the {person} has {athing}.
 the {thing} plus the {other} | makes {n}.
 also, | there was another {thing}.
 = furthermore, | the {person} {did} {athing}.
 = {athing}, | plus another {thing}.
chop_point
 clearly, | the {thing} is {adj}.
 the fact is | that the {person} {did} the {thing}.
 you definitely need to {do} the {thing}.
 the {thing} must be {adj}, | it must.
 = clearly you need to {do} the {thing}.
 = the {person} will definitely {do} the {thing}.
chin_think
 let me think | where the {thing} is.
 hmm, | maybe the {person} {did} it.
 interesting, | {athing} in the {place}.
 I wonder | whether the {thing} is {adj}.
 let me think | about the {adj} {thing}.
 = interesting, | the {thing} was never {adj}.
 = I wonder about the {thing} | in the {place}.
head_scratch
 I forgot | where the {thing} is.
 the {person} was confused | about the {thing}.
 it is hard to say | which {thing} is {adj}.
 how strange, | {athing} without {athing2}.
 I am puzzled, | who {did} the {thing}?
 = hard to say, | it looked like {athing}.
 = now I am confused, | which {thing} is it?
"""
