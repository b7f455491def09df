-- Values of a definition and what expressions do with them.
--
-- Numbers are Lua's, exact up to 2^53; larger ones are tables with their decimal digits (`wide`), which can be shown and
-- compared. Texts are strings, bytes are tables with a string (`raw`), lists have `items`, records have `rec`. Flags are
-- 1 and 0. What cannot be worked out raises an error; `limit` in it says that only this file cannot do it.

local X = {}
local MOST = 2 ^ 53
local floor, fmod = math.floor, math.fmod
local NOTHING = {}
X.nothing = NOTHING

local function fail(why)
  error({ why = why }, 0)
end

local function limit(why)
  error({ limit = why }, 0)
end
X.limit = limit

-- Bit operations of 32 bits: a library of Lua 5.2 and Wireshark's, or operators of Lua 5.3.
local native = bit32
if not native then
  local made = load
    and load("return { band = function(a, b) return a & b end, bor = function(a, b) return a | b end, bxor = function(a, b) return a ~ b end }")
  native = made and made() or bit
end
local band, bor, bxor = native.band, native.bor, native.bxor

function X.bytes(raw)
  return { raw = raw }
end

function X.list(items, count)
  items.items = count or #items
  return items
end

local function text_of(number)
  return string.format("%.0f", number)
end

function X.shown(value)
  if type(value) == "number" then
    return value == floor(value) and math.abs(value) < MOST and text_of(value) or string.format("%.15g", value)
  end
  if type(value) == "string" then
    return value
  end
  if value == NOTHING then
    return "nothing"
  end
  if value.wide then
    return value.wide
  end
  if value.raw then
    return X.hex(value.raw)
  end
  if value.items then
    local parts = {}
    for place = 1, value.items do
      parts[place] = X.shown(value[place])
    end
    return "[" .. table.concat(parts, ", ") .. "]"
  end
  return "a record"
end

function X.hex(raw)
  return (raw:gsub(".", function(sign)
    return string.format("%02X ", sign:byte())
  end):gsub(" $", ""))
end

-- ---- numbers ----------------------------------------------------------------------------------------------------

local function whole(value)
  if type(value) == "number" then
    return value
  end
  if type(value) == "table" and value.wide then
    limit("a number of more than 53 bits in an expression")
  end
  fail("no number")
end

local function exact(value)
  if value >= MOST or value <= -MOST then
    limit("a number of more than 53 bits in an expression")
  end
  return value + 0
end

local function truth(value)
  if type(value) == "number" then
    return value ~= 0
  end
  if type(value) == "string" then
    return value ~= ""
  end
  if value == NOTHING or value == nil then
    return false
  end
  if value.raw then
    return value.raw ~= ""
  end
  if value.items then
    return value.items > 0
  end
  return true
end
X.truth = truth

local function flag(value)
  return value and 1 or 0
end

local function bits(operation, a, b)
  a, b = whole(a), whole(b)
  local low = operation(a % 2 ^ 32, b % 2 ^ 32) % 2 ^ 32
  local high = operation(floor(a / 2 ^ 32) % 2 ^ 32, floor(b / 2 ^ 32) % 2 ^ 32) % 2 ^ 32
  if high >= 2 ^ 31 then
    high = high - 2 ^ 32
  end
  return exact(high * 2 ^ 32 + low)
end

function X.band(a, b)
  return bits(band, a, b)
end

function X.bor(a, b)
  return bits(bor, a, b)
end

function X.bxor(a, b)
  return bits(bxor, a, b)
end

function X.shl(a, b)
  b = whole(b)
  if b < 0 then
    fail("a negative shift")
  end
  return exact((whole(a) + 0.0) * 2 ^ math.min(b, 256))
end

function X.shr(a, b)
  b = whole(b)
  if b < 0 then
    fail("a negative shift")
  end
  return floor(whole(a) / 2 ^ math.min(b, 256)) + 0
end

local function modulo(a, b)
  a, b = whole(a), whole(b)
  if b == 0 then
    fail("divided by 0")
  end
  local rest = fmod(a + 0.0, b + 0.0)
  if rest ~= 0 and (rest < 0) ~= (b < 0) then
    rest = rest + b
  end
  return rest + 0
end
X.mod = modulo

function X.div(a, b)
  local rest = modulo(a, b)
  return floor((a - rest) / b + 0.5) + 0
end

function X.mul(a, b)
  return exact((whole(a) + 0.0) * whole(b))
end

function X.sub(a, b)
  return exact(whole(a) - whole(b))
end

function X.neg(a)
  return -whole(a) + 0
end

function X.inv(a)
  return -whole(a) - 1
end

function X.no(a)
  return flag(not truth(a))
end

function X.add(a, b)
  if type(a) == "number" and type(b) == "number" then
    return exact(a + b)
  end
  if type(a) == "string" and type(b) == "string" then
    return a .. b
  end
  if type(a) == "table" and type(b) == "table" then
    if a.raw and b.raw then
      return X.bytes(a.raw .. b.raw)
    end
    if a.items and b.items then
      local all = {}
      for place = 1, a.items do
        all[place] = a[place]
      end
      for place = 1, b.items do
        all[a.items + place] = b[place]
      end
      return X.list(all, a.items + b.items)
    end
  end
  return exact(whole(a) + whole(b))
end

-- ---- comparing --------------------------------------------------------------------------------------------------

local function equal(a, b)
  if type(a) ~= "table" or type(b) ~= "table" then
    return a == b
  end
  if a == b then
    return true
  end
  if a.wide or b.wide then
    return a.wide == b.wide
  end
  if a.raw or b.raw then
    return a.raw == b.raw
  end
  if a.items and a.items == b.items then
    for place = 1, a.items do
      if not equal(a[place], b[place]) then
        return false
      end
    end
    return true
  end
  if a.rec and b.rec then
    for name, value in pairs(a.rec) do
      if b.rec[name] == nil or not equal(value, b.rec[name]) then
        return false
      end
    end
    for name in pairs(b.rec) do
      if a.rec[name] == nil then
        return false
      end
    end
    return true
  end
  return false
end
X.equal = equal

function X.eq(a, b)
  return flag(equal(a, b))
end

function X.ne(a, b)
  return flag(not equal(a, b))
end

local function less(a, b)
  if type(a) == "string" and type(b) == "string" then
    for place = 1, math.min(#a, #b) do -- as bytes, whatever the place's language is
      local x, y = a:byte(place), b:byte(place)
      if x ~= y then
        return x < y
      end
    end
    return #a < #b
  end
  if type(a) == "table" and type(b) == "table" and a.raw and b.raw then
    return less(a.raw, b.raw)
  end
  return whole(a) < whole(b)
end

function X.lt(a, b)
  return flag(less(a, b))
end

function X.gt(a, b)
  return flag(less(b, a))
end

function X.le(a, b)
  return flag(not less(b, a))
end

function X.ge(a, b)
  return flag(not less(a, b))
end

local function entry(of, key)
  local found = of.entries[key]
  if found == nil and type(key) == "number" then
    for _, range in ipairs(of.ranges) do
      if range[1] <= key and key <= range[2] then
        return range[3]
      end
    end
  end
  return found
end

local function holds(all, one)
  if type(all) == "string" then
    if type(one) ~= "string" then
      fail("no text")
    end
    return all:find(one, 1, true) ~= nil
  end
  if type(all) ~= "table" or all == NOTHING then
    fail("nothing to look in")
  end
  if all.raw then
    if type(one) == "number" then
      return all.raw:find(string.char(one), 1, true) ~= nil
    end
    return all.raw:find(one.raw, 1, true) ~= nil
  end
  if all.entries then
    return entry(all, one) ~= nil
  end
  for place = 1, all.items or 0 do
    if equal(all[place], one) then
      return true
    end
  end
  return false
end

function X.isin(a, b)
  return flag(holds(b, a))
end

function X.notin(a, b)
  return flag(not holds(b, a))
end

function X.all(...)
  local value
  for place = 1, select("#", ...) do
    value = select(place, ...)()
    if not truth(value) then
      return value
    end
  end
  return value
end

function X.any(...)
  local value
  for place = 1, select("#", ...) do
    value = select(place, ...)()
    if truth(value) then
      return value
    end
  end
  return value
end

function X.choose(condition, first, second)
  if truth(condition) then
    return first()
  end
  return second()
end

-- ---- parts of values --------------------------------------------------------------------------------------------

function X.len(value)
  if type(value) == "string" then
    return #value
  end
  if type(value) == "table" then
    if value.raw then
      return #value.raw
    end
    if value.items then
      return value.items
    end
    if value.entries then
      local count = 0
      for _ in pairs(value.entries) do
        count = count + 1
      end
      return count
    end
  end
  fail("no length")
end

function X.attr(value, name)
  if value == NOTHING then
    return NOTHING
  end
  if type(value) ~= "table" then
    fail("no parts")
  end
  if value.items then
    local all = {}
    for place = 1, value.items do
      all[place] = X.attr(value[place], name)
    end
    return X.list(all, value.items)
  end
  if value.rec then
    local found = value.rec[name]
    if found == nil then
      if value.inner then
        fail("another frame")
      end
      return NOTHING
    end
    return found
  end
  if value.entries and value.entries[name] ~= nil then
    return value.entries[name]
  end
  fail("no such part")
end

function X.index(value, place)
  if type(value) == "table" and value.entries then
    local found = entry(value, place)
    if found == nil then
      fail("no such entry")
    end
    return found
  end
  local size = X.len(value)
  place = whole(place)
  if place < 0 then
    place = place + size
  end
  if place < 0 or place >= size then
    fail("no such place")
  end
  if type(value) == "string" then
    return value:sub(place + 1, place + 1)
  end
  return value.raw and value.raw:byte(place + 1) or value[place + 1]
end

function X.item_at(value, place)
  if place == NOTHING then
    return NOTHING
  end
  return X.index(value, place)
end

function X.slice(value, first, last)
  local size = X.len(value)
  local function edge(place, otherwise)
    if place == nil then
      return otherwise
    end
    place = whole(place)
    return math.max(0, math.min(place < 0 and place + size or place, size))
  end
  first, last = edge(first, 0), edge(last, size)
  if type(value) == "string" then
    return value:sub(first + 1, last)
  end
  if value.raw then
    return X.bytes(value.raw:sub(first + 1, last))
  end
  local all = {}
  for place = first + 1, last do
    all[#all + 1] = value[place]
  end
  return X.list(all)
end

-- ---- functions --------------------------------------------------------------------------------------------------

local function least_of(better, ...)
  local all = { ... }
  if #all == 1 and type(all[1]) == "table" and all[1].items then
    all = all[1]
  end
  local found = all[1]
  if found == nil then
    fail("no values")
  end
  for place = 2, all.items or #all do
    if better(all[place], found) then
      found = all[place]
    end
  end
  return found
end

function X.min(...)
  return least_of(less, ...)
end

function X.max(...)
  return least_of(function(a, b)
    return less(b, a)
  end, ...)
end

function X.abs(a)
  return math.abs(whole(a))
end

function X.sum(list)
  local total = 0
  if type(list) == "table" and list.raw then
    for place = 1, #list.raw do
      total = total + list.raw:byte(place)
    end
    return total
  end
  for place = 1, X.len(list) do
    total = X.add(total, list[place])
  end
  return total
end

local function of_text(change)
  return function(value)
    if type(value) == "table" and value.raw then
      return X.bytes(change(value.raw))
    end
    if type(value) ~= "string" then
      fail("no text")
    end
    return change(value)
  end
end

X.lower = of_text(function(text)
  return (text:gsub("[A-Z]", function(sign)
    return string.char(sign:byte() + 32)
  end))
end)
X.upper = of_text(function(text)
  return (text:gsub("[a-z]", function(sign)
    return string.char(sign:byte() - 32)
  end))
end)

function X.text(value)
  if type(value) == "number" and value == floor(value) then
    return text_of(value)
  end
  if type(value) == "string" then
    return value
  end
  limit("a value as a text")
end

local DIGITS = "0123456789ABCDEFGHIJKLMNOPQRSTUVWXYZ"

function X.number(value, base)
  base = base or 10
  local text = type(value) == "table" and value.raw or value
  if type(text) ~= "string" or text == "" then
    fail("no number")
  end
  local total = 0
  for place = 1, #text do
    local digit = DIGITS:find(text:sub(place, place):upper(), 1, true)
    if not digit or digit > base then
      fail("no number")
    end
    total = exact(total * base + digit - 1)
  end
  return total
end

function X.digits(number, width, base)
  base = base or 16
  number, width = whole(number), whole(width)
  if number < 0 or width > 4096 or not (base == 16 or base == 10 or base == 8 or base == 2) then
    fail("no digits")
  end
  local text = ""
  while number > 0 do
    local digit = modulo(number, base)
    text = DIGITS:sub(digit + 1, digit + 1) .. text
    number = (number - digit) / base
  end
  if #text > width then
    fail("too many digits")
  end
  return string.rep("0", width - #text) .. text
end

function X.bit(a, place)
  return modulo(X.shr(a, place), 2)
end

function X.rotl8(a, places)
  places = modulo(places, 8)
  a = modulo(a, 256)
  local turned = a * 2 ^ places
  return modulo(turned, 256) + floor(turned / 256)
end

function X.same(list)
  for place = 2, X.len(list) do
    if not equal(list[1], list[place]) then
      return 0
    end
  end
  return 1
end

function X.only(text, letters)
  local all, some = text, letters
  if type(text) == "table" then
    all, some = text.raw, letters.raw
  end
  for place = 1, #all do
    if not some:find(all:sub(place, place), 1, true) then
      return 0
    end
  end
  return 1
end

function X.get(of, key, default)
  if type(of) ~= "table" or not of.entries then
    fail("no table")
  end
  local found = entry(of, key)
  if found == nil then
    return default
  end
  return found
end

local function found_in(of, value, better)
  local best
  local function look(key, one)
    if equal(one, value) and (best == nil or better(key, best)) then
      best = key
    end
  end
  if of.items then
    for place = 1, of.items do
      look(place - 1, of[place])
    end
  else
    for key, one in pairs(of.entries) do
      look(key, one)
    end
  end
  if best == nil then
    return NOTHING
  end
  return best
end

function X.find(of, value)
  return found_in(of, value, less)
end

function X.find_last(of, value)
  return found_in(of, value, function(a, b)
    return less(b, a)
  end)
end

function X.either(a, b)
  if a == NOTHING then
    return b
  end
  return a
end

function X.span(place, count)
  if whole(count) == 0 then
    return 0
  end
  return floor((modulo(place, 8) + count + 7) / 8)
end

function X.ms(a)
  return X.mul(a, 1000000)
end

function X.xor(a, b)
  if type(a) ~= "table" or type(b) ~= "table" or not a.raw or not b.raw or #a.raw ~= #b.raw then
    fail("no bytes")
  end
  local all = {}
  for place = 1, #a.raw do
    all[place] = string.char(bxor(a.raw:byte(place), b.raw:byte(place)))
  end
  return X.bytes(table.concat(all))
end
