"""Sentences whose words call for the named gestures without captured strokes, by the label of the gesture.

The form is that of `grammar`: slots in braces, `|` ends a phrase, and a line that starts with "=" is held out for test.
The first part holds the core gestures, which talk often calls for; the last one adds to the sentences of gestures with
captured strokes (`meaning_sentences`), for cue phrases that the detector knows.
"""

CORE_SENTENCES = """
air_quotes
 the so-called {person} {did} the {thing}.
 it is what they call {athing}, | in quotes.
 that {thing} is a myth, | the {person} says.
 = this so-called {thing} | was never {adj}.
 = the {person} was, | quote unquote, | too {adj}.
calm_down
 calm down, | the {thing} is still in the {place}.
 do not worry, | the {person} will {do} the {thing}.
 take it easy | with the {adj} {thing}.
 = slow down, | the {place} is {adj} today.
 = don't panic, | the {person} has the {thing}.
decrease
 there are fewer and fewer {things} | in the {place}.
 the price of the {thing} went down, | at last.
 the number of {things} is declining.
 we reduced the {thing} | to {n} {things}.
 = the {things} in the {place} are shrinking.
 = less and less | do people {do} {things}.
equal_level
 the {thing} is the same | as the {other}.
 both {things} are alike, | says the {person}.
 it makes no difference | which {thing} you {do}.
 = every {person} is equal | in the {place}.
 = we want a fair share | of the {things}.
hands_over_heart
 thank you | for the {adj} {thing}.
 I am so grateful | for the {thing} of the {person}.
 we love this {thing} | with all our heart.
 I am really proud | of the {person}.
 = thank you so much, | dear {person}.
 = I appreciate the {thing} | from the {place}.
increase
 better and better | became the {thing}.
 the price of the {thing} is rising.
 the {place} grew | from {n} {things} to {n2}.
 the number of {things} doubled | {time}.
 = bigger and bigger | became the {thing}.
 = the {person} saw the {things} increase.
join_hands
 we {did} the {thing} together, | the {person} and I.
 side by side | we walked to the {place}.
 let us join forces | with the {person}.
 the {person} and the {someone} are united.
 = we must unite | behind the {person}.
 = the {person} combined the {thing} | with the {other}.
now_press
 right now | the {thing} is {adj}.
 at this moment | the {person} is in the {place}.
 this is the {thing} of today, | not of last year.
 we must {do} the {thing} now.
 = tonight | the {person} will {do} the {thing}.
 = these days | every {thing} is {adj}.
number_one
 first, | take the {thing} to the {place}.
 there is one thing | that the {person} forgot.
 number one, | the {thing} is {adj}.
 firstly, | the {thing} was {adj}.
 = the first reason | is the {adj} {thing}.
 = for the first time | the {person} {did} {athing}.
number_two
 second, | the {person} needs {athing}.
 there are two ways | to {do} the {thing}.
 there were two reasons | for the {thing}.
 = secondly, | the {thing} was in the {place}.
 = we have two options | for the {thing}.
number_three
 third, | nobody {did} the {thing}.
 there are three reasons | to {do} the {thing}.
 I have three questions | about the {thing}.
 = thirdly, | the {person} had no time.
 = I saw three things | in the {place}.
point_ahead
 from now on | we {do} the {thing} every day.
 think about the future | of the {thing}.
 tomorrow | the {person} goes to the {place}.
 let us move forward | with the {adj} {thing}.
 = next year | the {thing} will be {adj}.
 = in the years to come | every {person} has {athing}.
point_back
 back then | the {thing} was {adj}.
 {n} years ago | the {person} {did} the {thing}.
 in the past | nobody went to the {place}.
 last year | we had {athing}.
 = in those days | the {place} was {adj}.
 = look back | at the {thing} of the {person}.
point_up
 look up, | there is {athing} over the {place}.
 the {thing} is at the top, | above the {other}.
 upstairs | the {person} keeps the {things}.
 = in the sky | above us | hung the {thing}.
 = high above the {place} | flies {athing}.
small_pinch
 it is just a little bit | more {adj} than the {other}.
 a tiny {thing} | was in the {place}.
 the {thing} is slightly {adj}.
 only the smallest {things} | fit into the {place}.
 = there is a small part | of the {thing} left.
 = the {thing} was so small | that the {person} missed it.
so_so
 the {thing} was more or less {adj}.
 it takes {n} days, | give or take.
 the {thing} is sort of {adj}, | sort of.
 the {person} is, | well, | a mediocre {someone}.
 = there are roughly {n} {things} in the {place}.
 = the {thing} is a little shaky.
step_by_step
 step by step | the {person} {did} the {thing}.
 gradually | the {thing} became {adj}.
 one by one | we took the {things} to the {place}.
 = day by day | the {place} becomes more {adj}.
 = little by little | the {person} {did} it.
they_over_there
 those people | never {did} the {thing}.
 the other team | has a better {thing}.
 they said | that the {thing} was {adj}.
 I gave {athing} to the others.
 = these people | came from the {place}.
 = the other side | wants the {thing}.
thumbs_up
 great job, | the {thing} is {adj}.
 that is excellent, | {person}.
 a {adj} {thing}, | sounds good.
 well done, | that was {athing} for the {place}.
 = good work | on the {thing}.
 = that's perfect, | the {thing} fits.
wait_finger
 just a second, | where is the {thing}?
 one more thing, | the {person} has the {other}.
 before I forget, | the {thing} is in the {place}.
 give me a minute | with the {thing}.
 = one last thing | about the {person}.
 = one more question | about the {thing}.
wave_goodbye
 goodbye, | and take the {thing} with you.
 see you tomorrow | in the {place}.
 good night, | dear {person}.
 that was the {thing}, | take care.
 = until next time, | in the {place}.
 = farewell, | old {thing}.
weigh_options
 on the one hand | the {thing} is {adj}.
 we have the choice, | the {thing} or the {other}.
 either the {thing} or the {other}, | not both.
 = the {person} weighs the pros and cons | of the {thing}.
 = compare the {thing} | with the {other}.
"""
MORE_SENTENCES = """
arms_crossed
 I am not convinced | that the {thing} is {adj}.
 prove it to me, | where is the {thing}?
 = the {person} is sceptical | about the {thing}.
beckon
 come here | and look at the {thing}.
 follow me, | I know the {place}.
 come closer, | the {thing} is {adj}.
 = come on in, | the {person} has {athing}.
bow
 it was an honor | to meet the {person}.
 I apologize | for the {adj} {thing}.
 = it is a great privilege | to {do} the {thing}.
brush_off
 no problem, | I have another {thing}.
 it doesn't matter | who {did} the {thing}.
 it was no big deal, | only {athing}.
 = ignore it, | the {thing} is always {adj}.
check_watch
 we are running out of time | with the {thing}.
 hurry, | the {person} leaves the {place}.
 the {thing} came too late.
 = the deadline for the {thing} | is here.
close_lid
 close the {place}, | the {person} has left.
 the {person} slammed the {thing}.
 the {person} closed the {thing}.
 = shut the {place} | before the {thing} is gone.
count_off
 there are several reasons | to {do} the {thing}.
 the following {things} | are {adj}.
 let me list | the {things} of the {person}.
 = here are a few points | about the {thing}.
drive_wheel
 the {person} was driving to the {place}.
 behind the wheel | sat the {person}.
 = we drove to the {place} | for {athing}.
eat_drink
 a cup of tea | and {athing}, please.
 I am so hungry, | where is the {thing}?
 we ate {things} | with the {person}.
 = let us drink to the {person}.
exchange
 we swapped the {thing} | for the {other}.
 back and forth | went the {thing}.
 the {person} replaced the {thing}.
 = they exchanged {things} | in the {place}.
explode
 suddenly | the {thing} was gone.
 the {thing} exploded | in the {place}.
 boom, | and the {person} had no {thing}.
 = all of a sudden | the {thing} was {adj}.
facepalm
 oh no, | I forgot the {thing}.
 how stupid, | the {thing} is in the {place}.
 = how embarrassing, | my {thing} was {adj}.
finger_wag_no
 no, no, | the {thing} stays in the {place}.
 don't you dare | to {do} the {thing}.
 = not so fast, | the {person} has the {thing}.
fist_pump
 nailed it, | the {thing} is {adj}.
 we got the {thing}, | let's go!
 = what a triumph, | {athing} for the {place}.
fist_resolve
 we will win, | said the {person} of the {place}.
 we will fight for the {thing}.
 the {person} is strong, | and the {thing} is {adj}.
 = we must stand up for the {person}.
flat_surface
 the {place} is flat, | and the {thing} is {adj}.
 put the {thing} on the table.
 = the {thing} needs a flat surface.
flex_arm
 look at that muscle, | says the {person}.
 the {person} is muscle, | nothing else.
 = all muscle | and no {thing}.
hand_to_ear
 I can't hear the {person}.
 listen, | there is {athing} in the {place}.
 say that again, | which {thing}?
 = listen to the {thing} | of the {person}.
hands_on_hips
 well then, | where is the {thing}?
 seriously, | the {person} has {athing}?
 = well then, | who {did} the {thing}?
heart_hands
 I saw the {thing} and | I just love it.
 such {athing}, | love it.
 = the {person} saw the {thing} | and said, | love it.
hug_self
 the {person} needs a hug.
 I miss you | and the {thing}.
 it was freezing | in the {place}.
 = she hugged the {person} | by the {place}.
hush_finger
 be quiet, | the {person} is in the {place}.
 the {thing} is a secret.
 quietly | we {did} the {thing}.
 = keep it quiet | about the {thing}.
idea_finger
 I have an idea, | we {do} the {thing}.
 by the way, | the {thing} is {adj}.
 remember, | the {person} has the {thing}.
 = don't forget | the {thing} in the {place}.
interlock
 hand in hand | they went to the {place}.
 the {thing} fits together | with the {other}.
 = the {thing} and the {other} | are linked.
long_stretch
 it is a very long way | to the {place}.
 for years | nobody {did} the {thing}.
 all the way to the {place} | went the {thing}.
 = the {thing} took a really long time.
low_hand
 when I was a child | we had {athing}.
 a little girl | {did} the {thing}.
 = as a little kid | I saw {athing}.
money_rub
 the {thing} is too expensive | for the {person}.
 that {thing} costs us a {other}, | all our money.
 who pays for the {thing}?
 = the {thing} was really expensive.
narrow
 the {place} is narrow | and {adj}.
 we squeezed the {thing} | into the {place}.
 = it was a close call | for the {thing}.
number_five
 there are five things | in the {place}.
 the {person} has five points | about the {thing}.
 = fifth, | take the {thing} home.
number_four
 there are four ways | to the {place}.
 the {person} had four questions.
 = fourth, | the {thing} is {adj}.
oath_hand
 I promise, | the {thing} was {adj}.
 I swear | that the {person} {did} it.
 to tell you the truth, | it was {athing}.
 = honestly, | I never saw the {thing}.
open_door
 open the {place}, | here comes the {person}.
 the {person} opened up the {thing}.
 = unlock the {place} | for the {person}.
phone_hand
 call me | when you have the {thing}.
 the {person} was on the phone | about the {thing}.
 = she was on the phone | with the {person}.
point_down
 downstairs | the {person} keeps {athing}.
 the {thing} fell on the ground.
 at the bottom of the {place} | lies {athing}.
 = look down, | there is {athing}.
prayer_hands
 I hope | the {thing} is {adj}.
 let us pray | for the {person}.
 = hopefully | the {person} {did} the {thing}.
precision_pinch
 to be exact, | it was {athing}.
 to be precise, | there were {n} {things}.
 the {thing} in particular | was {adj}.
 = the key point | is the {thing}.
push_away
 no thanks, | I have {athing}.
 the {person} refused the {thing}.
 stay away from the {adj} {thing}.
 = the {person} rejected | the {thing}.
quick_snap
 just like that, | the {thing} was gone.
 immediately | the {person} {did} the {thing}.
 = overnight | the {place} became {adj}.
roll_hands
 {things}, {things2}, and so on, | in the {place}.
 over and over | the {person} {did} the {thing}.
 we keep going | to the {place}.
 = again and again | the {thing} was {adj}.
round_shape
 the {things} stood in a circle | by the {place}.
 round and round | went the {thing}.
 = the {thing} is a ball, | a {adj} one.
rub_hands
 I can't wait | to {do} the {thing}.
 we are so excited | about the {thing}.
 = I look forward to the {thing}.
salute
 yes sir, | the {thing} is {adj}.
 understood, | I take the {thing} to the {place}.
 = at your service, | {person}.
sleep_cheek
 the {person} was asleep | in the {place}.
 the {person} was so tired | in the {place}.
 = we went to bed | with the {thing}.
split_apart
 we split the {thing} | with the {person}.
 the {thing} broke in half.
 what divides the {place} | is the {thing}.
 = the {thing} fell apart | in the {place}.
tall_hand
 the {person} is very tall.
 the {thing} was this high, | and {adj}.
 = the {other} is taller | than the {thing}.
thumbs_down
 that's a terrible idea, | a {adj} {thing}.
 the {thing} was a disaster.
 the {thing} is even worse | than the {other}.
 = it was awful, | that {thing}.
turn_back
 we went back | to the {place}.
 once again | the {thing} is {adj}.
 the {person} turned around | in the {place}.
 = start over | with the {thing}.
typing
 the {person} was typing | in the {place}.
 she emailed me | about the {thing}.
 = type it in, | the {thing} of the {person}.
up_and_down
 up and down | went the {thing}.
 there were ups and downs | with the {thing}.
 = like a rollercoaster | was the {thing}.
write_air
 write it down, | {n} {things}.
 the {person} took notes | about the {thing}.
 = sign here | for the {thing}.
zip_lips
 my lips are sealed | about the {thing}.
 the {thing} is confidential, | not a word.
 = not a word | about the {thing}.
"""
FURTHER_SENTENCES = """
receive
 we received {athing} | from the {person}.
 I received the {thing} | in the {place}.
 = we received {things} | from the {place}.
clap
 a round of applause | for the {person}.
 give it up for the {thing} | of the {place}.
 = let's hear it for the {person} | of the {place}.
cheer_arms
 we did it, | the {thing} is {adj}.
 at long last | we have {athing}.
 = we made it, | with the {person} and the {thing}.
point_there
 the {thing} is over there.
 right there | stood the {person}.
 across the street | is the {place}.
 = out there | is {athing} for the {person}.
point_you
 some of you | know the {thing}.
 do you have {athing} | in the {place}?
 what about you, | have you got the {thing}?
 = all of you | saw the {thing}.
usher
 please welcome | the {person}.
 this way, | the {thing} is here.
 = let me introduce you | to the {person}.
chop_point
 make no mistake, | the {thing} is {adj}.
 let me be clear, | the {thing} stays in the {place}.
 = the fact is, | nobody {did} the {thing}.
box_frame
 this part of the {place} | is {adj}.
 the category of the {thing} | is not the {other}.
 that section of the {place} | is {adj}.
 = there is a category | for every {thing}.
"""
