-- Frames read from bytes: each segment in its order, what must hold for it, and the first thing that does not.
--
-- It is framekit's careful reading (`diagnose`), so that both tell the same of the same bytes. A reading `n` knows its
-- bytes, where it stands, the values found (`scopes`), what is to be shown (`shown`) and the faults (`notes`). In a
-- stream (`n.open`) the end is not known: there the same segments only say how many bytes a frame takes.

local R = { frames = {}, given = {}, tables = {}, state = {} }
local STOP, WANT, QUIET, NOT = {}, {}, {}, {}
local MOST_SHOWN = 4000
local kinds = {}

local function reading(raw)
  return {
    raw = raw, at = 0, stop = #raw, scopes = { { values = { rec = {} }, left = {} } }, path = "", bounds = {}, turn = 0,
    turns = {}, starts = {}, shown = {}, notes = { warnings = {}, unverified = {} }, deferred = {}, passed = {}, late = {},
  }
end

local function wire(n, place)
  if not n.places then
    return place
  end
  return n.places[math.min(place, #n.places - 1) + 1]
end

-- ---- values -----------------------------------------------------------------------------------------------------

function X.of(n, name)
  local item
  for place = #n.scopes, 1, -1 do
    local scope = n.scopes[place]
    local value = scope.values.rec[name]
    if value ~= nil then
      if type(value) == "table" and value.items and value.items > 0 and item and value[value.items] == item then
        local before = {}
        for index = 1, value.items - 1 do
          before[index] = value[index]
        end
        return X.list(before, value.items - 1)
      end
      return value
    end
    if scope.left[name] then
      return X.nothing
    end
    item = scope.values
  end
  error({ why = name .. " is not there" }, 0)
end

function X.given(_, name)
  local value = R.state[name]
  if value == nil then
    value = R.given[name]
  elseif type(value) == "table" and value.limit then
    X.limit(value.limit)
  end
  if value == nil then
    X.limit("'" .. name .. "', which is not known here")
  end
  return value
end

function X.table(name)
  return R.tables[name]
end

function X.item(n, word)
  local item = n.item
  if word == "item.index" then
    return item.index
  elseif word == "item.previous" then
    return item.previous or X.nothing
  end
  if item.ended ~= nil then
    return item.ended and 1 or 0
  elseif item.count then
    return item.index == item.count - 1 and 1 or 0
  end
  return n.at + item.filled >= n.stop and 1 or 0
end

function X.room(n, ...)
  local total = 0
  for place = 1, select("#", ...) do
    local bounds = n.bounds[select(place, ...)]
    if bounds then
      total = total + bounds[3] - bounds[2]
    end
  end
  return total
end

function X.before(n)
  return n.raw:sub(1, n.at)
end

function X.from(n, path)
  return n.raw:sub(n.bounds[path][2] + 1, n.at)
end

function X.bytes_of(n, ...)
  local parts = {}
  for place = 1, select("#", ...) do
    local bounds = n.bounds[select(place, ...)]
    parts[place] = bounds[1]:sub(bounds[2] + 1, bounds[3])
  end
  return table.concat(parts)
end

-- ---- faults -----------------------------------------------------------------------------------------------------

local function note_at(n, place, cause, segment, expected, found, refuse, turn)
  if n.quiet then
    return
  end
  local notes = n.notes
  if not notes.first or place < notes.first.place or (place == notes.first.place and turn < notes.turn) then
    notes.turn = turn
    notes.first =
      { cause = cause, segment = n.path .. segment, place = place, expected = expected, found = found, refuse = refuse }
  end
end

local function note(n, cause, s, place, expected, found, refuse)
  if n.open then
    return
  end
  note_at(n, wire(n, place), cause, s.shown, expected, found, refuse or s.refuse, n.turns[s.path] or n.turn)
end

local function stop(n, cause, s, expected, found)
  if n.open then
    error(NOT, 0)
  end
  note(n, cause, s, n.at, expected, found)
  error(STOP, 0)
end

local FRAME = { key = "frame", path = "frame", shown = "frame" }

-- What a function of the reading gives; nil where it cannot be worked out. Limits of this file go on.
local function try(n, what)
  local fine, found = pcall(what, n)
  if fine then
    return found
  end
  if type(found) == "table" and found.limit then
    error(found, 0)
  end
  return nil
end

-- A segment without the code that its faults are refused with.
local function bare(s)
  return { key = s.key, path = s.path, shown = s.shown }
end

local function ask(n, what, cause, s)
  if type(what) ~= "function" then
    return what
  end
  local found = try(n, what)
  if found == nil or (cause ~= "value" and type(found) ~= "number") then
    if type(found) == "table" and found.wide then
      X.limit("a size of more than 53 bits")
    end
    stop(n, cause, s, "values it can be worked out from", "none")
  end
  return found
end

-- ---- going on ---------------------------------------------------------------------------------------------------

local function begin(n, s)
  n.turn = n.turn + 1
  n.turns[s.path] = n.turn
  n.starts[s.path] = wire(n, n.at)
  return n.at
end

local function take(n, s, size)
  local start = n.at
  if size < 0 then
    stop(n, "length", s, "a size of at least 0", X.shown(-size) .. " less")
  end
  if start + size > n.stop then
    if n.open then
      n.wanted = start + size - n.stop
      error(WANT, 0)
    end
    stop(n, "short", s, X.shown(size) .. " bytes", X.shown(math.max(n.stop - start, 0)))
  end
  n.at = start + size
  n.bounds[s.path] = { n.raw, start, n.at }
  return n.raw:sub(start + 1, n.at)
end

local function show(n, s, start, value)
  if not n.open and #n.shown < MOST_SHOWN then
    n.shown[#n.shown + 1] = { path = n.path, s = s, first = start, last = n.at, value = value, places = n.places }
  end
end

-- Each segment behind one, those of records that are always there in place of these.
local function following(after)
  local stack = {}
  local function enter(segments, place)
    stack[#stack + 1] = { segments, place }
  end
  return function()
    while true do
      local top = stack[#stack]
      if top then
        local s = top[1][top[2]]
        if not s then
          stack[#stack] = nil
        else
          top[2] = top[2] + 1
          if s.kind == "record" and not s.when then
            enter(s.of, 1)
          else
            return s
          end
        end
      elseif after then
        local here = after
        after = here.after
        enter(here.segments, here.place)
      else
        return nil
      end
    end
  end
end

local function is_told(n, s)
  for _, path in ipairs(s.told or {}) do
    if not n.passed[path] then
      return false
    end
  end
  return true
end

local function knows_behind(n, after)
  if n.in_item then
    return false
  end
  for s in following(after) do
    if not s.size_known or not is_told(n, s) then
      return false
    end
  end
  return true
end

-- How many bytes stand behind a segment that reaches as far as what follows leaves room.
local function behind(n, after)
  if knows_behind(n, after) then
    local total = 0
    for s in following(after) do
      if not s.when or X.truth(s.when(n)) then
        total = total + s.size_known
      end
    end
    return total
  end
  local first = following(after)()
  if not first or first.kind ~= "const" or first.when then
    X.limit("where a part ends")
  end
  local place = n.raw:find(first.data, n.at + 1, true)
  if not place or place - 1 + #first.data > n.stop then
    error({ why = "no end" }, 0)
  end
  return n.stop - (place - 1)
end

local ends_here

-- In a stream the end is where the constant behind it stands and all around fits.
local function rest_of_stream(n, s, after)
  local before, total, constant = 0, 0, nil
  for one in following(after) do
    if not one.size_known or not is_told(n, one) then
      error(QUIET, 0)
    end
    if not one.when or X.truth(one.when(n)) then
      if not constant and one.kind == "const" and not one.when then
        constant, before = one, total
      end
      total = total + one.size_known
    end
  end
  if not constant then
    error(QUIET, 0)
  end
  local place = n.at + before
  while true do
    place = n.raw:find(constant.data:sub(1, 1), place + 1, true)
    if not place or place > n.stop then
      n.wanted = 1
      error(WANT, 0)
    end
    place = place - 1
    local size = place - before + total
    if size > n.stop then
      n.wanted = size - n.stop
      error(WANT, 0)
    end
    if not s.may_hold or not n.has_check or ends_here(n, size, place - before) then
      return place - before - n.at
    end
    place = place + 1
  end
end

local function rest(n, s, after)
  if n.open and not n.bounded then
    return rest_of_stream(n, s, after)
  end
  local following = ask(n, function()
    return behind(n, after)
  end, "length", bare(s))
  local available = math.max(n.stop - n.at, 0)
  if available < following then
    local unit = following == 1 and " byte" or " bytes"
    stop(n, "short", bare(s), "at least " .. X.shown(following) .. unit, X.shown(available))
  end
  return available - following
end

-- ---- parts ------------------------------------------------------------------------------------------------------

local read_all

local function guarded(n, action, stopped)
  local scopes, path, item = #n.scopes, n.path, n.item
  local fine, why = pcall(action)
  if fine then
    return
  end
  if why ~= STOP then
    error(why, 0)
  end
  for place = #n.scopes, scopes + 1, -1 do
    n.scopes[place] = nil
  end
  n.path, n.item = path, item
  stopped()
end

-- A part with `size` bytes behind it; however it goes, reading goes on there.
local function part(n, size, surplus, checks, action)
  local whole = n.stop
  n.stop = whole - size
  guarded(n, function()
    action()
    if n.at < n.stop then
      n.turn = n.turn + 1
      note(n, "surplus", FRAME, n.at, "its end", X.shown(n.stop - n.at) .. " bytes more", surplus)
    end
  end, function()
    n.notes.unchecked = n.notes.unchecked or checks
  end)
  n.at, n.stop = n.stop, whole
end

local function run_deferred(n, from, all)
  local kept = {}
  for place = from, #n.deferred do
    local one = n.deferred[place]
    n.deferred[place] = nil
    local ready = true
    for _, path in ipairs(all and {} or one.needs) do
      ready = ready and n.passed[path]
    end
    if ready then
      local scopes, path, item = n.scopes, n.path, n.item
      n.scopes, n.path, n.item = one.scopes, one.path, one.item
      one.action(n)
      n.scopes, n.path, n.item = scopes, path, item
    else
      kept[#kept + 1] = one
    end
  end
  for _, one in ipairs(kept) do
    n.deferred[#n.deferred + 1] = one
  end
end

local function later(n, needs, action)
  if n.open then
    return
  end
  local scopes = {}
  for place, scope in ipairs(n.scopes) do
    scopes[place] = scope
  end
  n.deferred[#n.deferred + 1] = { needs = needs, action = action, scopes = scopes, path = n.path, item = n.item }
end

-- The value of a segment is compared with what it should be, as far as that can be told.
local function same(cause, s, refuse)
  return function(n)
    local found = n.scopes[#n.scopes].values.rec[s.key]
    if not n.bounds[s.path] or found == nil then
      return
    end
    local right = try(n, s.is)
    local place, turn = n.starts[s.path], n.turns[s.path]
    if right == nil then
      if not n.notes.first and not n.notes.check then
        note_at(n, place, cause, s.shown, "values it can be worked out from", "none", refuse, turn)
      end
    elseif not X.equal(found, right) then
      note_at(n, place, cause, s.shown, X.shown(right), X.shown(found), refuse, turn)
    end
  end
end

local function store(n, s, name, shown, start, value)
  n.scopes[#n.scopes].values.rec[name] = value
  show(n, s, start, value)
end

local function among(value, allowed)
  for _, one in ipairs(allowed) do
    if X.equal(value, one) then
      return true
    end
  end
  return false
end

local function shown_all(values)
  local parts = {}
  for place, one in ipairs(values) do
    parts[place] = X.shown(one)
  end
  return table.concat(parts, " or ")
end

local function in_limits(value, limits)
  if type(value) == "table" and value.wide then
    return value.wide:sub(1, 1) == "-" and limits[1] <= -2 ^ 53 or value.wide:sub(1, 1) ~= "-" and limits[2] >= 2 ^ 53
  end
  return type(value) == "number" and limits[1] <= value and value <= limits[2]
end

local function validate(n, s, start, value)
  if s.among and not among(value, s.among) then
    note(n, s.among_cause or "value", s, start, shown_all(s.among), X.shown(value))
  end
  if s.limits and not in_limits(value, s.limits) then
    if n.open and not s.refuse then
      error(NOT, 0)
    end
    note(n, "range", s, start, X.shown(s.limits[1]) .. ".." .. X.shown(s.limits[2]), X.shown(value))
  end
end

-- The value of a number: what `plus`, `unit` and `zero_means` make of that on the wire.
local function valued(s, number)
  if number == X.nothing or (s.plus == nil and s.unit == nil and s.zero_means == nil) then
    return number
  end
  if s.zero_means and number == 0 then
    return s.zero_means
  end
  if s.plus then
    number = X.sub(number, s.plus)
  end
  return s.unit and X.mul(number, s.unit) or number
end

local function parsed(n, s, start, raw, of)
  local value = F.parse(of, raw)
  if value == nil then
    if n.open then
      error(NOT, 0)
    end
    note(n, "digits", s, start, "digits", X.hex(raw))
    show(n, s, start, X.bytes(raw))
    return
  end
  value = valued(s, value)
  store(n, s, s.key, s.shown, start, value)
  validate(n, s, start, value)
end

-- ---- kinds of segments ------------------------------------------------------------------------------------------

function kinds.const(n, s)
  local start = begin(n, s)
  if n.open and n.leading then
    local there = n.raw:sub(start + 1, math.min(start + #s.data, n.stop))
    if there ~= s.data:sub(1, #there) then
      error(NOT, 0)
    end
  end
  local found = take(n, s, #s.data)
  if found ~= s.data then
    note(n, "constant", s, start, X.hex(s.data), X.hex(found))
  end
  show(n, s, start, X.bytes(found))
end

function kinds.skip(n, s)
  local start = begin(n, s)
  show(n, s, start, X.bytes(take(n, s, s.size)))
end

function kinds.fill(n, s, after)
  local start = begin(n, s)
  local size = n.open and not n.bounded and s.total - s.fixed_after - n.at or rest(n, s, after)
  show(n, s, start, X.bytes(take(n, s, size)))
  if n.stop < s.total then
    note(n, "short", FRAME, n.stop, X.shown(s.total) .. " bytes", "")
  elseif n.stop > s.total then
    note(n, "surplus", FRAME, s.total, "its end", "")
  end
end

function kinds.field(n, s, after)
  local start = begin(n, s)
  local of = s.type
  if s.long then
    local raw = take(n, s, of.size)
    local first = F.parse(of, raw)
    if first == s.long.mark then
      raw, of = take(n, s, s.long.type.size), s.long.type
    end
    n.bounds[s.path] = { n.raw, start, n.at }
    parsed(n, s, start, raw, of)
  elseif s.stops then
    local place, size
    for _, one in ipairs(s.stops) do
      local found = n.raw:find(one, start + 1, true)
      if found and (not place or found < place) then
        place, size = found, #one
      end
    end
    local limit_ = s.keeps_stop and n.stop or n.stop - (size or 0)
    if not place or place - 1 > limit_ then
      if n.open then
        n.wanted = 1
        error(WANT, 0)
      end
      stop(n, "short", s, "the end", "none")
    end
    local raw = take(n, s, place - 1 - start)
    n.at = s.keeps_stop and place - 1 or place - 1 + size
    n.bounds[s.path] = { n.raw, start, n.at }
    parsed(n, s, start, raw, of)
  else
    local size = s.takes_rest and rest(n, s, after) or ask(n, s.size, "length", s)
    parsed(n, s, start, take(n, s, size), of)
  end
  if s.is then
    later(n, s.needs, same("value", s, s.refuse))
  end
end

function kinds.number(n, s) -- a length or a count
  local start = begin(n, s)
  parsed(n, s, start, take(n, s, ask(n, s.size, "length", s)), s.type)
  if s.is then
    later(n, s.needs, same("length", s, s.refuse))
  end
end

function kinds.bits(n, s)
  local start = begin(n, s)
  local raw = take(n, s, ask(n, s.size, "length", s))
  local number = F.parse(s.type, raw)
  if number == nil then
    if n.open then
      error(NOT, 0)
    end
    note(n, "digits", s, start, "digits", X.hex(raw))
    return
  end
  for _, one in ipairs(s.parts) do
    local value
    if type(number) == "number" then
      value = X.mod(X.shr(number, one.low), 2 ^ one.bits)
    else
      X.limit("bits of a number of more than 53 bits")
    end
    n.turns[one.path], n.starts[one.path], n.bounds[one.path] = n.turn, n.starts[s.path], n.bounds[s.path]
    store(n, one, one.key, one.shown, start, value)
    if one.among and not among(value, one.among) then
      note(n, one.among_cause, one, start, shown_all(one.among), X.shown(value), s.refuse)
    end
    if one.is then
      later(n, one.needs, same("value", one, s.refuse))
    end
  end
end

function kinds.data(n, s, after)
  local start = begin(n, s)
  local raw = take(n, s, s.takes_rest and rest(n, s, after) or ask(n, s.size, "length", s))
  local plain = raw
  if s.convert == "hex_to_ascii" then
    plain = F.unhex(raw)
  elseif s.convert == "ascii_to_hex" then
    plain = F.tohex(raw)
  end
  if not plain then
    if n.open then
      error(NOT, 0)
    end
    note(n, "digits", s, start, "digits", X.hex(raw))
    show(n, s, start, X.bytes(raw))
    return
  end
  local value = X.bytes(s.swap and F.swap(plain, s.swap) or plain)
  store(n, s, s.key, s.shown, start, value)
  if s.never then
    for place = 1, #raw do
      if s.never:find(raw:sub(place, place), 1, true) then
        note(n, "value", s, start + place - 1, "no " .. X.hex(s.never), X.hex(raw:sub(place, place)))
        break
      end
    end
  end
  if s.least and #value.raw < s.least then
    note(n, "short", s, start, "at least " .. X.shown(s.least) .. " bytes", X.shown(#value.raw))
  end
end

function kinds.value(n, s)
  local start = begin(n, s)
  local found = try(n, s.read)
  if found == nil then
    note(n, "value", s, start, "values it can be worked out from", "none")
    return
  end
  n.bounds[s.path] = { n.raw, start, start }
  store(n, s, s.key, s.shown, start, found)
end

function kinds.require(n, s)
  local start = begin(n, s)
  if not n.open and not X.truth(try(n, s.condition) or 0) then
    note(n, "require", s, start, s.text, "")
  end
end

local function wrong_check(n, s, place, expected, found)
  local fault = { cause = "check", segment = n.path .. s.shown, place = wire(n, place), expected = expected, found = found }
  if s.verify == "warn" then
    n.notes.warnings[#n.notes.warnings + 1] = fault
  elseif not n.notes.check or fault.place < n.notes.check.place then
    n.notes.check = fault
  end
end

local function verify(n, s)
  local bounds = n.bounds[s.path]
  local found = bounds[1]:sub(bounds[2] + 1, bounds[3])
  if s.unverified then
    n.notes.unverified[#n.notes.unverified + 1] = s.shown .. ": " .. s.unverified
    return
  end
  local wanted = try(n, function()
    return F.code_bytes(s, s.covered(n))
  end)
  if wanted == nil then
    if s.verify ~= "warn" then
      note(n, "value", s, bounds[2], "values it can be worked out from", "none")
      n.notes.unchecked = true
    end
  elseif found ~= wanted and not (s.digits and found:upper() == wanted:upper()) then
    wrong_check(n, s, bounds[2], X.hex(wanted), X.hex(found))
  end
end

function kinds.check(n, s)
  local start = begin(n, s)
  show(n, s, start, X.bytes(take(n, s, s.size)))
  if n.open or s.verify == "off" then
    return
  end
  if s.late then
    n.late[#n.late + 1] = { s, n.path }
    return
  end
  local last = n.at
  n.at = start
  verify(n, s)
  n.at = last
end

function kinds.record(n, s, after)
  local start = begin(n, s)
  local values = { rec = {} }
  n.scopes[#n.scopes].values.rec[s.key] = values
  local path = n.path
  n.path = path .. s.shown .. "."
  n.scopes[#n.scopes + 1] = { values = values, left = {} }
  read_all(n, s.of, after)
  n.scopes[#n.scopes] = nil
  n.path = path
  n.bounds[s.path] = { n.raw, start, n.at }
end

function kinds.list(n, s, after)
  local start = begin(n, s)
  local items = X.list({}, 0)
  if not s.single then
    n.scopes[#n.scopes].values.rec[s.key] = items
  end
  local count
  if s.times then
    count = ask(n, s.times, "length", s)
    if count < 0 then
      stop(n, "length", s, "at least 0 items", X.shown(-count) .. " less")
    end
  end
  local whole, ended, path, outer, in_item = n.stop, false, n.path, n.item, n.in_item
  if not count and not s.is_until then
    n.stop = start + rest(n, s, after)
  end
  local function goes_on()
    if s.is_until then
      return not ended
    elseif count then
      return items.items < count
    end
    return n.at < n.stop
  end
  while goes_on() do
    if items.items > 1048576 then
      X.limit("more than 1048576 items")
    end
    if s.between then
      n.at = n.at + -(n.at - start) % s.align
    end
    local at = n.at
    local values = { rec = {} }
    n.item = { index = items.items, previous = items[items.items], count = count, filled = s.between and 0 or s.align - 1 }
    local item = n.item
    items[items.items + 1], items.items = values, items.items + 1
    n.path = path .. s.shown .. "[" .. X.shown(item.index) .. "]."
    n.scopes[#n.scopes + 1] = { values = values, left = {} }
    n.in_item = true
    local first = #n.deferred + 1
    read_all(n, s.of, nil)
    run_deferred(n, first, true)
    n.in_item = in_item
    n.scopes[#n.scopes] = nil
    n.path = path
    ended = item.ended
    if n.at == at and not s.is_fixed then
      stop(n, "length", s, "items with bytes", "an empty one")
    end
    if not s.between then
      take(n, s, -(n.at - start) % s.align)
    end
  end
  n.stop, n.item = whole, outer
  n.bounds[s.path] = { n.raw, start, n.at }
  if s.single then -- the items are the values of this field; there is no list where one of them is wrong
    local values = X.list({}, items.items)
    for place = 1, items.items do
      values[place] = items[place].rec[s.single]
      if values[place] == nil then
        return
      end
    end
    n.scopes[#n.scopes].values.rec[s.key] = values
  end
end

function kinds.cannot(_, s)
  X.limit(s.why)
end

function kinds.item_end(n, s)
  if s.until_ then
    n.item.ended = X.truth(ask(n, s.until_, "value", s))
  end
end

function kinds.values(n, s, after)
  local start = begin(n, s)
  local size = s.item_size
  local room = s.times == nil and rest(n, s, after) or size * ask(n, s.times, "length", bare(s))
  local raw = take(n, s, room)
  if room % size ~= 0 then
    note(n, "short", s, start, X.shown(size) .. " bytes", X.shown(room % size))
    return
  end
  local items = {}
  for place = 1, #raw, size do
    local value = F.parse(s.type, raw:sub(place, place + size - 1))
    if value == nil then
      if n.open then
        error(NOT, 0)
      end
      note(n, "digits", s, start, "digits", X.hex(raw))
      show(n, s, start, X.bytes(raw))
      return
    end
    items[#items + 1] = value
  end
  store(n, s, s.key, s.shown, start, X.list(items))
end

local function leave_out(n, s)
  for _, name in ipairs(s.without or {}) do
    if n.scopes[#n.scopes].values.rec[name] == nil then
      n.scopes[#n.scopes].left[name] = true
    end
  end
  for _, path in ipairs(s.nowhere or {}) do
    n.bounds[path] = { n.raw, n.at, n.at }
  end
end

function kinds.choose(n, s, after)
  local value = ask(n, s.on, "value", bare(s))
  leave_out(n, s)
  for _, case in ipairs(s.cases) do
    if among(value, case.keys) then
      return read_all(n, case.of, after)
    end
  end
  if not s.otherwise then
    stop(n, "value", s, "one of the cases", X.shown(value))
  end
  return read_all(n, s.otherwise, after)
end

function kinds.optional(n, s, after)
  leave_out(n, s)
  if rest(n, s, after) > 0 then
    read_all(n, s.of, after)
  end
end

-- ---- wraps ------------------------------------------------------------------------------------------------------

-- The place of the first escape byte that is not doubled.
local function end_of_region(n, s)
  local of, place = s.coding, n.at
  local sign = string.char(of.escape)
  while true do
    place = n.raw:find(sign, place + 1, true)
    if not place or place + 1 > n.stop then
      if n.open then
        n.wanted = 1
        error(WANT, 0)
      end
      error({ why = "the region does not end" }, 0)
    end
    local second, skipped = n.raw:byte(place + 1), nil
    if second == of.escape then
      skipped = 2
    else
      for _, frame in ipairs(of.embedded) do
        if frame:byte(2) == second then
          skipped = #frame
          break
        end
      end
    end
    if not skipped then
      return place - 1
    end
    place = place - 1 + skipped
  end
end

-- The place behind so many plain bytes.
local function end_of_stuffed(n, s, size)
  local at = n.at
  for _ = 1, size do
    if at < n.stop and n.raw:byte(at + 1) == s.coding.escape then
      at = at + 1
      if at < n.stop and n.raw:byte(at + 1) ~= s.coding.escape then
        error({ why = "an escape byte is not doubled" }, 0)
      end
    end
    if at >= n.stop then
      if n.open then
        n.wanted = 1
        error(WANT, 0)
      end
      error({ why = "more bytes are wanted" }, 0)
    end
    at = at + 1
  end
  return at
end

local function reads_on(after)
  for s in following(after) do
    if s.size_known ~= 0 then
      return true
    end
  end
  return false
end

function kinds.wrap(n, s, after)
  local start = begin(n, s)
  local size = s.size
  if s.coding.escape and s.coding.kind == "doubled" then
    if s.plain_size then
      size = function()
        return end_of_stuffed(n, s, s.plain_size) - n.at
      end
    elseif n.open and not n.bounded or reads_on(after) then
      size = function()
        return end_of_region(n, s) - n.at
      end
    end
    if n.open and size then
      size = size()
    end
  end
  local room = size == nil and rest(n, s, after) or ask(n, size, "short", s)
  local raw = take(n, s, room)
  local plain, places, cause, expected, found, bad = F.open[s.coding.kind](s.coding, raw)
  if cause and n.open then
    if cause ~= "check" then
      error(NOT, 0)
    end
  elseif cause == "check" then
    wrong_check(n, s, start + bad, X.hex(expected), X.hex(found))
  elseif cause then
    local place = places[#places]
    note(n, cause, s, start + place, "wrapped content", X.hex(raw:sub(place + 1, place + 2)))
  end
  local has_content = not cause or cause == "check"
  local outer = { n.raw, n.at, n.stop, n.places, n.quiet, n.in_item, n.bounded }
  local wired = {}
  for place = 1, #places do
    wired[place] = wire(n, start + places[place])
  end
  n.raw, n.at, n.stop, n.places, n.in_item, n.bounded = plain, 0, #plain, wired, false, true
  n.quiet = n.quiet or not has_content
  local values, known, kept = n.scopes[#n.scopes].values.rec, {}, n.bounds
  if not has_content then
    for name in pairs(values) do
      known[name] = true
    end
    n.bounds = setmetatable({}, { __index = kept })
  end
  local shown = #n.shown
  local function close()
    if not has_content then
      n.bounds = kept
      for name in pairs(values) do
        if not known[name] then
          values[name] = nil
        end
      end
      for place = #n.shown, shown + 1, -1 do
        n.shown[place] = nil
      end
    end
    n.raw, n.at, n.stop, n.places, n.quiet, n.in_item, n.bounded =
      outer[1], outer[2], outer[3], outer[4], outer[5], outer[6], outer[7]
  end
  local fine, why = pcall(part, n, 0, nil, s.checks, function()
    if s.least and n.stop < s.least then
      note(n, "short", s, 0, "at least " .. X.shown(s.least) .. " bytes", "")
    end
    local most = type(s.most) == "function" and try(n, s.most) or s.most
    if s.most and (type(most) ~= "number" or n.stop > most) then
      note(n, "too_long", s, 0, "fewer bytes", "")
    end
    local first = #n.deferred + 1
    R.region(n, s)
    run_deferred(n, first, false)
  end)
  close()
  if not fine then
    error(why, 0)
  end
end

-- ---- frames inside ----------------------------------------------------------------------------------------------

-- Takes over what is told of the check codes of a frame inside.
local function adopt(n, one)
  for _, fault in ipairs(one.notes.warnings) do
    n.notes.warnings[#n.notes.warnings + 1] = fault
  end
  for _, text in ipairs(one.notes.unverified) do
    n.notes.unverified[#n.notes.unverified + 1] = text
  end
end

local measure_first, fault_of

-- None of the frames fits: the fault is that of the frame that was read furthest.
local function no_frame(n, s, start)
  local best, nearest, reach
  for _, name in ipairs(s.frames) do
    local frame = R.frames[name]
    local size = R.measure(frame, n.raw, start, n.stop)
    local one = R.read(frame, n.raw:sub(start + 1, type(size) == "number" and start + size or n.stop))
    if one.limited then
      X.limit(one.limited)
    end
    local fault = fault_of(one)
    local first = one.notes.first
    local reached = first and first.place or #n.raw + 1
    if fault and (not best or reached > reach) then
      best, reach, nearest = first or fault, reached, { path = n.path .. s.shown .. "." .. name .. ".", s = s, first = start, one = one, name = name, places = n.places }
    end
  end
  if not best then
    stop(n, "value", s, "one of its frames", X.hex(n.raw:sub(start + 1, n.stop)))
  end
  n.shown[#n.shown + 1] = nearest
  adopt(n, nearest.one)
  n.turn = n.turn + 1
  local inside = s.shown .. "." .. nearest.name .. "." .. best.segment
  note_at(n, wire(n, start + best.place), best.cause, inside, best.expected, best.found, nil, n.turn)
  error(STOP, 0)
end

function kinds.inner(n, s, after)
  local start = begin(n, s)
  local room
  if s.size then
    room = ask(n, s.size, "length", s)
  elseif n.open and not n.bounded then
    room = s.takes_rest and rest(n, s, after) or measure_first(n, s.frames, n.stop)
    if room == WANT or room == QUIET or room == NOT then
      error(room, 0)
    end
  elseif s.takes_rest or knows_behind(n, after) then
    room = rest(n, s, after)
  else
    room = measure_first(n, s.frames, n.stop)
    if type(room) ~= "number" then
      no_frame(n, s, start)
    end
  end
  local raw = take(n, s, room)
  if n.open then
    n.scopes[#n.scopes].values.rec[s.key] = X.nothing
    return
  end
  for _, name in ipairs(s.frames) do
    local frame = R.frames[name]
    if R.may_be(frame, raw, 0) then
      local one = R.read(frame, raw)
      if one.limited then
        X.limit(one.limited)
      end
      local fault = fault_of(one)
      if not fault or fault.refuse then
        n.scopes[#n.scopes].values.rec[s.key] = { rec = { [name] = one.scopes[1].values }, inner = true }
        show(n, s, start, name)
        n.shown[#n.shown + 1] =
          { path = n.path .. s.shown .. "." .. name .. ".", s = s, first = start, one = one, name = name, places = n.places }
        n.unknown = n.unknown or one.unknown
        adopt(n, one)
        if fault then
          n.turn = n.turn + 1
          local inside = s.shown .. "." .. name .. "." .. fault.segment
          note_at(n, wire(n, start + fault.place), fault.cause, inside, fault.expected, fault.found, fault.refuse, n.turn)
        end
        return
      end
    end
  end
  n.unknown = true
  n.scopes[#n.scopes].values.rec[s.key] =
    { rec = { unknown = { rec = { data = X.bytes(raw) } } }, inner = true }
  show(n, s, start, X.bytes(raw))
end

function kinds.nested(n, s)
  local start = begin(n, s)
  local frame = R.frames[s.frame]
  local size = measure_first(n, { s.frame }, n.stop)
  if n.open then
    if type(size) ~= "number" then
      error(size, 0)
    end
    take(n, s, size)
    n.scopes[#n.scopes].values.rec[s.key] = X.nothing
    return
  end
  local raw = type(size) == "number" and take(n, s, size) or n.raw:sub(start + 1, n.stop)
  local one = R.read(frame, raw)
  if one.limited then
    X.limit(one.limited)
  end
  n.scopes[#n.scopes].values.rec[s.key] = one.scopes[1].values
  n.shown[#n.shown + 1] = { path = n.path .. s.shown .. ".", s = s, first = start, one = one, places = n.places }
  adopt(n, one)
  local fault = fault_of(one)
  if fault then
    n.turn = n.turn + 1
    local inside = s.shown .. "." .. fault.segment
    note_at(n, wire(n, start + fault.place), fault.cause, inside, fault.expected, fault.found, fault.refuse, n.turn)
  end
  if type(size) ~= "number" then
    error(STOP, 0)
  end
end

-- ---- lists of segments ------------------------------------------------------------------------------------------

local function absent(n, s)
  if s.default then
    local start = begin(n, s)
    n.bounds[s.path] = { n.raw, start, start }
    local value = try(n, s.default)
    if value == nil then
      note(n, "value", s, start, "values it can be worked out from", "none")
    else
      n.scopes[#n.scopes].values.rec[s.key] = value
    end
    return
  end
  leave_out(n, s)
end

function read_all(n, segments, after)
  for place, s in ipairs(segments) do
    local behind_it = { segments = segments, place = place + 1, after = after }
    if not s.when then
      kinds[s.kind](n, s, behind_it)
    elseif X.truth(ask(n, s.when, "value", bare(s))) then
      kinds[s.kind](n, s, behind_it)
    else
      absent(n, s)
    end
    if s.kind ~= "const" then
      n.leading = false
    end
    for _, path in ipairs(s.paths or {}) do
      n.passed[path] = true
    end
  end
end

-- A whole buffer: what stands behind its last variable part is read from the end, whatever came before.
function R.region(n, of)
  if n.open and not of.tail_first then
    return read_all(n, of.of, nil)
  end
  if of.tail_first then -- a body that ends where the tail begins, whatever is in it
    read_all(n, of.head, { segments = of.body, place = 1, after = { segments = of.tail, place = 1 } })
    local place = n.raw:find(of.tail_first, n.at + 1, true)
    if not place or place > n.stop then
      if n.open then
        n.wanted = #of.tail
        error(WANT, 0)
      end
      stop(n, "short", { key = "tail", shown = "tail" }, X.hex(of.tail_first), "none")
    end
    if n.open then
      n.at = place - 1
    else
      part(n, n.stop - place + 1, of.surplus, of.middle_checks, function()
        read_all(n, of.body, nil)
      end)
    end
    return read_all(n, of.tail, nil)
  end
  local behind_middle = { segments = of.tail, place = 1 }
  read_all(n, of.front, nil)
  if #of.middle > 0 then
    local start, whole = n.at, n.stop
    local tail = whole - ask(n, function()
      return behind(n, behind_middle)
    end, "short", FRAME)
    guarded(n, function()
      read_all(n, of.middle, behind_middle)
    end, function()
      if tail < start then
        error(STOP, 0)
      end
      n.at, n.stop = tail, whole
      n.notes.unchecked = n.notes.unchecked or of.middle_checks
    end)
  end
  read_all(n, of.tail, nil)
end

-- ---- whole frames -----------------------------------------------------------------------------------------------

function fault_of(n)
  if n.notes.first and n.notes.unchecked then
    n.notes.first.refuse = nil
  end
  return n.notes.check or n.notes.first
end
R.fault_of = fault_of

local depth = 0

-- A frame read from exactly these bytes. `limited`: why this file cannot say whether they are one.
function R.read(frame, raw)
  local n = reading(raw)
  if depth > 30 then
    n.limited = "frames inside frames, more than 30 deep"
    return n
  end
  depth = depth + 1
  if frame.most and #raw > frame.most then
    note(n, "too_long", FRAME, frame.most, "at most " .. X.shown(frame.most) .. " bytes", X.shown(#raw))
  end
  local fine, why = pcall(function()
    part(n, 0, frame.surplus, frame.checks, function()
      R.region(n, frame)
      run_deferred(n, 1, true)
    end)
    for _, one in ipairs(n.late) do
      n.path = one[2]
      verify(n, one[1])
    end
  end)
  depth = depth - 1
  if not fine then
    -- a fault that was found before would be one however the rest is
    n.limited = type(why) == "table" and why.limit or (type(why) == "string" and why) or "something unforeseen"
    if n.notes.check or n.notes.first and not n.notes.first.refuse then
      n.limited = nil
    end
  end
  return n
end

-- Whether the bytes at fixed places do not contradict a frame.
function R.may_be(frame, raw, start)
  for _, one in ipairs(frame.fixed) do
    local sign = raw:sub(start + one[1] + 1, start + one[1] + 1)
    if sign ~= "" and not one[2]:find(sign, 1, true) then
      return false
    end
  end
  return true
end

-- How many bytes a frame takes that begins at a place of a stream: a number, or WANT (with how many), QUIET, NOT.
function R.measure(frame, raw, start, last)
  if not R.may_be(frame, raw, start) then
    return NOT
  end
  local size = frame.size_known
  if size and not frame.looks_inside then
    if last - start < size then
      return WANT, size - (last - start)
    end
    return size
  end
  local n = reading(raw:sub(start + 1, math.min(last, start + (frame.most or last) + 1)))
  n.open, n.leading, n.frame, n.has_check = true, true, frame, frame.has_check
  if depth > 30 then
    return NOT
  end
  depth = depth + 1
  local fine, why = pcall(R.region, n, frame)
  depth = depth - 1
  if fine then
    if frame.most and n.at > frame.most then
      return NOT
    end
    return n.at
  end
  if why == WANT then
    local most = frame.most or 66560
    if #n.raw + n.wanted > most then
      return NOT
    end
    return WANT, n.wanted
  elseif why == QUIET then
    return QUIET
  elseif type(why) == "table" and why.limit then
    return QUIET
  end
  return NOT
end

function ends_here(n, size, tail)
  local one = R.read(n.frame, n.raw:sub(1, size))
  local fault = fault_of(one)
  return one.limited ~= nil or not fault or (fault.cause ~= "check" and fault.place < tail)
end

function measure_first(n, frames, last)
  local want, quiet
  for _, name in ipairs(frames) do
    local frame = R.frames[name]
    local size, more = R.measure(frame, n.raw, n.at, last)
    if type(size) == "number" and size > 0 then
      if not want or not (n.open and not n.bounded) then
        local one = R.read(frame, n.raw:sub(n.at + 1, n.at + size))
        local fault = fault_of(one)
        if not fault or fault.refuse or one.limited then
          return size
        end
      end
    elseif size == WANT then
      want = math.max(want or 1, more or 1)
    elseif size == QUIET then
      quiet = true
    end
  end
  if want then
    n.wanted = want
    return WANT
  end
  return quiet and QUIET or NOT
end

-- The frame that bytes are, of some candidates in their order: the reading, its frame, and what it is refused with.
--
-- With no frame: the nearest one and its fault; `limited`: what this file cannot say of a frame that they may be.
function R.fit(names, raw)
  local unknown, refused, limited, nearest
  local function better(one, other)
    local function fitness(n)
      local check, first = n.notes.check, n.notes.first
      if check then
        return not first, first and first.place or check.place
      end
      return false, first.place
    end
    local whole, place = fitness(one)
    local whole_before, place_before = fitness(other)
    if whole ~= whole_before then
      return whole
    end
    return place > place_before
  end
  for _, name in ipairs(names) do
    local frame = R.frames[name]
    local n = R.read(frame, raw)
    local fault = fault_of(n)
    if n.limited then
      limited = limited or { frame = frame, limited = n.limited }
    elseif not fault then
      n.frame = frame
      if frame.refuse then
        refused = refused or { n, frame.refuse }
      elseif limited then
        break -- it may be the one before
      elseif not n.unknown then
        return n
      else
        unknown = unknown or n
      end
    else
      n.frame = frame
      if fault.refuse and fault.cause ~= "check" then
        refused = refused or { n, fault.refuse }
      end
      if not nearest or better(n, nearest) then
        nearest = n
      end
    end
  end
  if limited then
    return nil, nil, limited
  end
  if unknown then
    return unknown
  elseif refused then
    return refused[1], refused[2]
  end
  return nil, nearest
end

-- Takes a frame of the definition: cuts its segments into those before, in and behind its variable part.
function R.add(frame)
  local function cut(of)
    if of.of and not of.front then
      local middle, tail = of.from_middle or #of.of + 1, of.from_tail or #of.of + 1
      of.front, of.middle, of.tail = {}, {}, {}
      for place, s in ipairs(of.of) do
        local into = place < middle and of.front or place < tail and of.middle or of.tail
        into[#into + 1] = s
      end
    end
  end
  local function enter(segments)
    for _, s in ipairs(segments or {}) do
      s.path = s.path or s.key
      for _, one in ipairs(s.parts or {}) do
        one.path = one.path or one.key
      end
      if s.kind == "wrap" then
        cut(s)
      end
      enter(s.of)
      enter(s.otherwise)
      for _, case in ipairs(s.cases or {}) do
        enter(case.of)
      end
    end
  end
  cut(frame)
  enter(frame.of)
  enter(frame.head)
  enter(frame.body)
  if frame.head then
    enter(frame.tail)
  end
  R.frames[frame.name] = frame
end
